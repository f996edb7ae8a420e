"""Common options of commands, and translation of messages of the library into terms of options.

Messages of the library name Python arguments ("half_width must lie in ..."). `Command` replaces these names by options
in errors, remarks and all other lines ("--half-width must lie in ..."). The replacements follow from the options of the
command and from the tables below.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand, TyperGroup

from matcam.cli import help_page, show
from matcam.core.errors import MatcamError
from matcam.core.io import Outputs, all_or_nothing
from matcam.core.memory import check_address_space
from matcam.core.registry import CFAS, FAMILIES, FITTED_LENSES, FRESNEL_MODELS, MASKING_MODELS, PARAMETRIC_LENSES
from matcam.files import formats

_RENAMED = {
    "camera": "lens",
    "camera_parameters": "lens",
    "cell_value": "cell",
    "f_numbers": "f_number",
    "lamp_azimuth": "azimuth",
    "lamp_radius": "lamp",
    "noise": "relative",
    "noise.floor": "floor",
    "noise.relative": "relative",
    "pixel_phase": "phase",
    "pixel_pitch": "pitch",
    "pixels_across": "pixels",
    "shape": "size",
}
"""Arguments of the library, and the parameters of commands that have another name for them."""

_PHRASES = {
    "(Camera(..., uncertainty=...))": "(--camera: a profile with an uncertainty)",
    "Camera(optics, pixel, sensor=Sensor(...))": "a profile with a sensor (--camera)",
    "give the lens of one colour, or a GaussianOptics that is as wide as this lens": "give a profile with a Gaussian lens that "
    "is as wide as this lens (--camera)",
    "page must lie in": "--size must lie in",
    "use Camera(optics.at(x, y), pixel)": "give the profile of a lens that is equal in the field (--camera)",
    "use Camera(optics.red, pixel), or optics.green or optics.blue": "give the profile of one colour (--camera)",
}
"""Replacements for Python expressions in messages."""

_SCALES = {
    "--lamp": (180 / math.pi, "degrees"),
    "--lamp-angle": (180 / math.pi, "degrees"),
    "--azimuth": (180 / math.pi, "degrees"),
    "--last": (180 / math.pi, "degrees"),
    "--pitch": (1e6, "um"),
    "--wavelength": (1e9, "nm"),
}
"""Options whose unit is not that of the library (rad, m): factor from the unit of the library, and unit."""


def option(names: str, metavar: str, help: str, **more: Any) -> Any:  # noqa: A002
    """Declare an option with a value.

    `names` contains the names of the option, separated by spaces. `more` are further arguments of `typer.Option`.
    """
    return typer.Option(*names.split(), metavar=metavar, help=help, **more)


if TYPE_CHECKING:
    from matcam.core.workspace import Workspace

    Family = str
    FamilyOrAuto = str
    Masking = str | None
    FresnelModel = str
    Lens = str
    EdgeLens = str
    Mosaic = str | None
else:  # Literal types of the names in the registries, as typer requires

    def _one_of(names: Iterable[str | None]) -> Any:
        return Literal[tuple(name or "none" for name in names)]

    _AUTO = "Family of the lobe; auto: the family that fits the data best."
    _FRESNEL = (
        "Fresnel term: n and k (conductor), f0 (schlick), eta (dielectric), or one value for each theta_d (free)."
    )
    Family = Annotated[_one_of(FAMILIES), typer.Option("--ndf", help="Family of the lobe.")]
    FamilyOrAuto = Annotated[_one_of(["auto", *FAMILIES]), typer.Option("--ndf", help=_AUTO)]
    Masking = Annotated[
        _one_of([*MASKING_MODELS, None]),
        typer.Option(
            "--masking",
            callback=lambda name: None if name == "none" else name,
            help="Masking function G of the material.",
        ),
    ]
    FresnelModel = Annotated[_one_of(FRESNEL_MODELS), typer.Option("--fresnel", help=_FRESNEL)]
    Lens = Annotated[_one_of(FITTED_LENSES), typer.Option("--model", help="Model of the lens.")]
    EdgeLens = Annotated[_one_of(PARAMETRIC_LENSES), typer.Option("--model", help="Lens of the parametric estimate.")]
    Mosaic = Annotated[
        _one_of(CFAS) | None,
        typer.Option("--cfa", help="Colours of the first 2 x 2 px, if the image is a mosaic."),
    ]

Device = Annotated[
    Literal["cpu", "gpu"] | None,
    typer.Option("--device", help="Device for the computation. Default: cpu, with a remark if there is a GPU."),
]


def _budget(path: Path | None) -> Path | None:
    from matcam.numerics.budget import check_budget_name

    if path is not None:
        check_budget_name(path)
    return path


Budget = Annotated[
    Path | None,
    option(
        "--budget",
        "FILE",
        "Uncertainty budget to write (.json, .csv): sources, combined and expanded uncertainty (GUM).",
        callback=_budget,
    ),
]
ForceCorrection = Annotated[
    bool,
    typer.Option(
        "--force-correction",
        help="Correct a table even if its data contradict the rig. Without this option such a table is not changed.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing output.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print only the result as JSON to standard output.")]
Power = Annotated[
    float | None,
    option("--power", "P", "Power p of an epd or sgd lobe, required for these (no unit)."),
]
Sampling = Annotated[
    Literal["centre", "edge"],
    typer.Option(
        "--sampling", help="Position in its cell at which a value is sampled. A MERL file does not specify it."
    ),
]
Wavelength = Annotated[
    float | None,
    option("--wavelength", "NM", "Wavelength of the light for diffraction and defocus, nm."),
]


def pitch_option(use: str) -> Any:
    """Declare --pitch with the range of pixel pitches in the library.

    `use` is the end of its help.
    """

    def checked(pitch: float | None) -> float | None:
        from matcam.core import checks

        return None if pitch is None else float(checks.within("--pitch", pitch, 1e-2, 1e4, "um"))

    return option("--pitch", "UM", f"Pixel pitch, um{use}", callback=checked)


Pitch = Annotated[float | None, pitch_option(": for diffraction and defocus, and to print frequencies in lp/mm.")]
HalfWidth = Annotated[float, option("--half-width", "PX", "Half the width of a pixel's sensitive area, px.")]


def use_caches() -> Workspace:
    """Enable the cache of compiled functions, and open the cache of results that depend only on a rig.

    Both are in the user's cache folder.

    Returns:
        Workspace with the cached results.
    """
    from matcam.core.jax import use_compilation_cache
    from matcam.core.workspace import Workspace

    use_compilation_cache()
    return Workspace.user()


def choose_device(device: str | None) -> None:
    """Select the device for JAX.

    Args:
        device: "cpu" or "gpu". None: the processor, which is faster for one table, because a GPU requires longer
            compilation. In this case a remark is printed if the machine has a GPU.
    """
    from matcam.core.jax import has_gpu, use_device

    chosen: Any = device or "cpu"
    use_device(chosen)
    if device is None and has_gpu():
        show.remark(
            "computing on the processor, which is faster than the GPU for one table; to use the GPU, give --device gpu"
        )


class Group(TyperGroup):
    """Group of commands, listed in the help by purpose."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments. Without arguments, print the help and exit with code 2."""
        if not args and not ctx.resilient_parsing:
            typer.echo(ctx.get_help(), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        formatter.write(help_page.page(self, ctx))


_outputs_of_command: list[Outputs] = []


def files_are_written() -> bool:
    return any(outputs.are_published for outputs in _outputs_of_command)


class Command(TyperCommand):
    """Command whose errors refer to its options.

    If a command returns, or raises `typer.Exit` with any exit code, its output files are published. After any other
    exception no file is published.
    """

    def format_help(self, ctx: Any, formatter: Any) -> None:
        formatter.write(help_page.page(self, ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments. Commas may separate the values of an option."""
        several = {name for p in self.params if p.param_type_name == "option" and p.nargs > 1 for name in p.opts}
        split: list[str] = []
        for word in args:
            name, equals, value = word.partition("=")
            if equals and name in several:
                split += [name, *value.split(",")]
            elif split and split[-1] in several and "," in word:
                split += word.split(",")
            else:
                split.append(word)
        return super().parse_args(ctx, split)

    def invoke(self, ctx: Any) -> Any:
        check_address_space()
        values = [value if isinstance(value, list) else [value] for value in ctx.params.values()]
        modules = formats.decoded_by(path for paths in values for path in paths if isinstance(path, Path))
        if modules:
            from matcam.core.readers.apart import start_reader

            start_reader(modules)
        result: Any = None
        try:
            with all_or_nothing() as outputs:  # an exception discards the files
                _outputs_of_command.append(outputs)
                try:
                    with show.wording(lambda text: in_options(text, self)):
                        result = super().invoke(ctx)
                except typer.Exit as end:
                    result = end.exit_code
        except MatcamError as error:
            error.args = (in_options(str(error), self), *error.args[1:])
            raise
        if isinstance(result, int) and result:
            raise typer.Exit(result)
        return result


def in_options(message: str, command: TyperCommand) -> str:
    options = {str(p.name): max(p.opts, key=len) for p in command.params if p.param_type_name == "option"}
    renamed = {argument: options[name] for argument, name in _RENAMED.items() if name in options}
    return _translated(message, {**options, **renamed})


def _translated(message: str, option_of: Mapping[str, str]) -> str:
    message = re.sub(r"; if \S+ is in degrees, give np\.radians\(\S+\)$", "", message)  # options take degrees
    for phrase, words in _PHRASES.items():
        message = message.replace(phrase, words)

    def assignment(found: re.Match[str]) -> str:
        option = option_of.get(found[1])
        if option is None:
            return found[0]
        return option if found[3] == "True" else f"{option} {found[3]}"

    def name(found: re.Match[str]) -> str:
        return option_of.get(found[0], found[0])

    message = re.sub(r"\b([a-z_]+)=('?)(\w+)\2", assignment, message)
    # a word without an underscore is an argument only if it is the subject
    verbs = "must|can|belongs|needs|asks|as|may"
    subject = re.match(rf"(?:[a-z_]+ and )?[a-z_.]+(?= (?:'\S*' )?(?:{verbs})\b)", message)
    if subject:
        message = re.sub(r"[a-z_.]+", name, subject[0]) + message[subject.end() :]
    message = re.sub(r"(?<![\w/.-])[a-z]+(?:_[a-z]+)+(?![\w/.-])", name, message)
    message = re.sub(r"(?<=\bgive )[a-z]+(?= if | \()", name, message)
    return _in_unit(message)


def _in_unit(message: str) -> str:
    """Convert the numbers in a message about the range of an option to the unit of that option."""
    option = message.partition(" ")[0]
    if option not in _SCALES:
        return message
    scale, unit = _SCALES[option]
    message = re.sub(r"\b(must be given) in m\b", r"\1", message)  # the help of the option names its unit

    def converted(found: re.Match[str]) -> str:
        low, high, value = (f"{scale * float(found[i]):.4g}" for i in (2, 3, 6))
        why = (found[5] or "").replace("pi", "180 degrees")
        why = f" ({why})" if why and not why[0].isdigit() else ""  # digits: example of 550 nm in m
        return f"must lie in {found[1]}{low}, {high}{found[4]} {unit}{why}, got {value}"

    number = r"(?:nan|[-+\d.einf]+)"
    pattern = rf"must lie in ([\[(])({number}), ({number})([\])]) (?:rad|m)\b(?: \(([^)]*)\))?, got ({number})"
    return re.sub(pattern, converted, message)
