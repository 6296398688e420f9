"""Progress for those who read a log: a line now and then, with what is left."""

import os

from certnav.nav.commands.cli import main
from certnav.nav.commands.terminal.progress import QUIET, LineProgress, progress


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def test_a_line_every_ten_seconds_with_the_time_left(capsys):
    clock = Clock()
    with LineProgress(clock) as report:
        for second in range(41):
            clock.now = 100.0 + second
            report(second / 80.0, "filter")
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "certnav: filter, 12%, about 70 s left", "certnav: filter, 25%, about 60 s left",
        "certnav: filter, 38%, about 50 s left", "certnav: filter, 50%, about 40 s left",
    ]  # fmt: skip


def test_what_is_left_is_counted_from_where_a_phase_began(capsys):
    clock = Clock()
    with LineProgress(clock) as report:
        report(0.9, "reading")
        clock.now += 30.0
        report(0.0, "filter")  # says what is done, but knows nothing of the time it takes
        clock.now += 10.0
        report(0.5, "filter")
    assert capsys.readouterr().err.splitlines() == [
        "certnav: filter", "certnav: filter, 50%, about 10 s left",
    ]  # fmt: skip


def test_quick_work_says_nothing(capsys):
    clock = Clock()
    with LineProgress(clock) as report:
        clock.now += 9.0
        report(1.0, "filter")
    assert not capsys.readouterr().err


def test_quiet_means_no_line_at_all(monkeypatch, capsys):
    monkeypatch.setenv(QUIET, "1")
    with progress() as report:
        report(0.5, "filter")
    assert not isinstance(progress(), LineProgress)
    assert not capsys.readouterr().err


def test_quiet_leaves_errors_and_what_is_asked_for(tmp_path, capsys):
    missing = str(tmp_path / "nowhere")
    assert main(["-q", "run", missing]) == main(["run", "--quiet", missing]) == 1
    said = capsys.readouterr()
    assert said.err.count("no such file or folder") == 2 and not said.out
    assert main(["-q", "datasets"]) == 0
    assert not capsys.readouterr().out
    assert QUIET not in os.environ
