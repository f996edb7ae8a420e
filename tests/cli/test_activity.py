"""The line that shows what a command is doing."""

import io
import sys
import time
from types import SimpleNamespace

import pytest

from matcam.cli import activity, show


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(activity, "_FIRST", 0.02)
    monkeypatch.setattr(activity, "_EACH", 0.01)
    screen = Terminal()
    monkeypatch.setattr(activity, "sys", SimpleNamespace(stderr=screen, modules=sys.modules))
    return screen


def after(seconds, terminal):
    time.sleep(seconds)
    return terminal.getvalue().split("\r\033[2K")[-1]


def test_the_line_names_what_is_done_and_is_gone_at_the_end(terminal, capsys):
    with activity.shown("fresnel"):
        assert "fresnel: starting 0 s" in after(0.2, terminal)
        with show.working("fitting\x1b[31m the lobe"):
            line = after(0.2, terminal)
            assert "fitting" in line
            assert "\x1b" not in line
            assert "first run on this machine" in line  # the tests have JAX
        show.say("a result")
        assert after(0.2, terminal) == ""  # nothing is left to be done
    assert terminal.getvalue().endswith("\r\033[2K")
    assert activity._shown == []


def test_a_long_command_tells_how_long_it_took_last_time(terminal, monkeypatch):
    monkeypatch.setattr(activity, "_LONG", 0.1)
    for expected in (False, True):
        with activity.shown("correct"):
            assert ("last run: 0 s" in after(0.3, terminal)) == expected


def test_nothing_is_shown_where_no_terminal_is(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(activity, "sys", SimpleNamespace(stderr=stream, modules=sys.modules))
    with activity.shown("fresnel"), show.working("fitting"):
        time.sleep(0.05)
    assert stream.getvalue() == ""


def test_a_damaged_memory_is_no_fault(terminal, tmp_path):
    (tmp_path / "cache" / "matcam").mkdir(parents=True)
    (tmp_path / "cache" / "matcam" / "durations.json").write_text("[1")
    with activity.shown("predict"):
        assert "predict" in after(0.2, terminal)
