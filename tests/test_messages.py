"""Every message of the error family: one line that says what was wrong, where, and what would be right.

The messages are collected from the sources, whether a test can provoke them or not. A placeholder stands for a value.
"""

import re

import typer

from docs_messages import ABOVE, FAMILY, PLACE, SOURCES, collected
from matcam.cli.app import app

NAMES = ("BRDF", "MERL", "Mitsuba", "RGL", "Zarr")
"""Words that may begin a message with a capital letter."""

RIGHT = re.compile(
    r"\b(must|needs?|needed|requires?|give|specify|use|choose|name|install|wait|see|ask|call|leave|render|append|calibrate|photograph|only"
    r"|at least|at most|fewer|more than|instead|can|cannot|goes into|it has|are read|is for|are for|belongs|takes?|reads)\b"
)
"""A message that is no file's says with one of these what would be right; or it gives the reason after a colon."""


EXCEPTIONS = {
    "unknown {} {}; {}": "the last value names what is known, or the nearest of it",
    "{} of shape (height, width) or (height, width, 3), got {} {}": "the first value says that it must be numbers",
}
"""Messages whose values say what would be right, and how."""


def own():
    """The others pass on, behind a file's name at most, what another message of the family says."""
    return [m for m in collected() if re.search("[a-z]", m.text)]


def wrong(rule, messages=None):
    """The messages that break a rule, by default of all of our own, for a failure that names them all."""
    return [str(message) for message in (own() if messages is None else messages) if not rule(message)]


def test_all_are_found():
    assert len(collected()) > 350
    assert {m.error for m in collected()} >= FAMILY - {"MatcamError"}
    assert set(ABOVE) <= {m.error for m in collected()}
    raised = re.compile(r"raise (\w+Error)\(")
    for path in SOURCES.rglob("*.py"):
        unknown = set(raised.findall(path.read_text(encoding="utf-8"))) - FAMILY - set(ABOVE)
        # errors of Python are raised where a program is wrong, or are caught where they are raised
        assert unknown <= {
            "TypeError",
            "ValueError",
            "ConnectionError",
            "RemoteIOError",
            "KeyError",
            "NotImplementedError",
            "PermissionError",
            "_EndedError",
        }, path


def test_each_is_one_line_without_an_end():
    assert wrong(lambda m: "\n" not in m.text, collected()) == []
    assert wrong(lambda m: not m.text.rstrip().endswith((".", "!")), collected()) == []
    assert wrong(lambda m: m.text == m.text.strip() and "  " not in m.text, collected()) == []


def test_each_begins_in_the_middle_of_a_sentence_or_with_a_name():
    assert wrong(lambda m: re.match(r"[a-z{]|--|f/", m.text) or m.text.startswith(NAMES)) == []


def test_those_of_a_file_begin_with_its_name():
    """And say behind it what is wrong there, with its own reason or what is read instead."""
    of_files = [m for m in own() if m.error in ("FileFormatError", "DownloadError")]
    assert wrong(lambda m: re.match(r"\{\}(: | does not)", m.text), of_files) == []


def test_those_of_an_output_name_it():
    of_outputs = [m for m in own() if m.error == "OutputError"]
    assert wrong(lambda m: re.match(r"(output|picture)( folder)? \{\}", m.text), of_outputs) == []


def test_all_others_say_what_would_be_right():
    others = [m for m in own() if m.error not in ("FileFormatError", "DownloadError")]
    assert wrong(lambda m: RIGHT.search(m.text) or ": " in m.text or m.text in EXCEPTIONS, others) == []
    assert set(EXCEPTIONS) <= {m.text for m in others}


def test_what_must_be_says_what_was():
    """An argument that must be something is told with the value that it had, or cannot have had one."""
    no_value = ("must be given", "must be finite", "must be symmetric", "got none")
    stated = [m for m in own() if m.error == "ArgumentError" and re.match(r"\S+ must (be|lie|have) ", m.text)]
    assert len(stated) > 60
    assert wrong(lambda m: PLACE in m.text or any(words in m.text for words in no_value), stated) == []


def test_the_command_line_speaks_of_options():
    """Its own messages name no argument of Python; those of the library are translated where they do."""
    python = re.compile(r"\b\w+=(True|False|None|')")
    assert wrong(lambda m: not python.search(m.text), [m for m in collected() if m.position.startswith("cli/")]) == []
    # arguments of the library with an option of another name, or without one
    of_commands = {"camera", "camera_parameters"}
    for command in typer.main.get_command(app).commands.values():
        of_commands |= {p.name for one in getattr(command, "commands", {"": command}).values() for p in one.params}

    def translated(message):
        return all(found[0].split("=")[0] in of_commands for found in python.finditer(message.text))

    assert wrong(translated, collected()) == []
