"""Lens with separate optics for red, green and blue, because glass is dispersive."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from matcam.camera.optics.optics import Optics
from matcam.camera.optics.varying import VaryingOptics
from matcam.core import checks
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    from matcam.core.jax import jax


class ColourOptics(VaryingOptics):
    """Lens with a separate blur and shift for each colour channel.

    `picture` supports this lens: channel k of the image is recorded through lens k. The image has three channels, even
    if the material has one.

    Args:
        red: lens of the first channel.
        green: lens of the second channel.
        blue: lens of the third channel.
        red_shift: shift of the image of the first channel relative to the optical axis (lateral colour), (right, up),
            px, uniform over the image. Default: (0, 0).
        green_shift: shift of the second channel, px. Default: (0, 0).
        blue_shift: shift of the third channel, px. Default: (0, 0).

    Raises:
        ArgumentError: a lens is not Optics, or is a ColourOptics; or a shift is not a pair of numbers in [-100, 100] px.

    Source:
        Kingslake & Johnson, Lens Design Fundamentals, chapter 5 (lateral colour).

    Example:
        >>> lens = matcam.ColourOptics(*(matcam.DiffractionOptics(8.0, 1e-9 * nm, 5e-6) for nm in (620, 540, 460)))
        >>> float(lens.red.cutoff) < float(lens.blue.cutoff)
        True
    """

    red: Optics
    green: Optics
    blue: Optics
    red_shift: jax.Array
    green_shift: jax.Array
    blue_shift: jax.Array

    profile_fields = MappingProxyType(
        {
            "red": "red",
            "green": "green",
            "blue": "blue",
            "red_shift_px": "red_shift",
            "green_shift_px": "green_shift",
            "blue_shift_px": "blue_shift",
        }
    )

    def __init__(
        self,
        red: Optics,
        green: Optics,
        blue: Optics,
        red_shift: Any = (0.0, 0.0),
        green_shift: Any = (0.0, 0.0),
        blue_shift: Any = (0.0, 0.0),
    ):
        for name, lens in (("red", red), ("green", green), ("blue", blue)):
            if not isinstance(lens, Optics) or isinstance(lens, ColourOptics):
                raise ArgumentError(f"{name} must be Optics other than ColourOptics, got {type(lens).__name__}")
        self.red, self.green, self.blue = red, green, blue
        self.red_shift = _shift("red_shift", red_shift)
        self.green_shift = _shift("green_shift", green_shift)
        self.blue_shift = _shift("blue_shift", blue_shift)

    @property
    def lenses(self) -> tuple[Optics, Optics, Optics]:
        """Lenses of the red, green and blue channel, in this order."""
        return self.red, self.green, self.blue

    @property
    def named_lenses(self) -> dict[str, Optics]:
        """Single lenses by name: "red", "green" and "blue".

        A channel whose lens varies over the image has names such as "red, centre".
        """
        named: dict[str, Optics] = {}
        for colour, lens in zip(("red", "green", "blue"), self.lenses, strict=True):
            if isinstance(lens, VaryingOptics):
                named |= {f"{colour}, {name}": one for name, one in lens.named_lenses.items()}
            else:
                named[colour] = lens
        return named

    @property
    def shifts(self) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Shifts of the red, green and blue channel, each (right, up), px."""
        return self.red_shift, self.green_shift, self.blue_shift

    def band(self) -> float:
        """Compute the largest band of the three lenses, cycles/px."""
        return max(lens.band() for lens in self.lenses)

    def instead(self) -> str:
        """Describe how to select a single lens, for an error message."""
        return "use Camera(optics.red, pixel), or optics.green or optics.blue"


def _shift(name: str, value: Any) -> jax.Array:
    shift = checks.within(name, value, -100.0, 100.0, "px")
    if shift.shape != (2,):
        raise ArgumentError(f"{name} must be two numbers (right, up), px, got an array of shape {shift.shape}")
    return shift
