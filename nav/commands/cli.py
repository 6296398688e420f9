"""The command line: the table of commands, and how errors end.

Each command is a module of this folder with ``HELP`` (its line in ``certnav --help``),
``DESCRIPTION``, ``add_arguments(parser)`` and ``run(arguments)``, which returns the exit status or
nothing. Whatever takes time to import is imported in ``run``.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import importlib
import os
import sys

from ...filters.errors import NavError

#: In the order of ``certnav --help``.
COMMANDS = (
    "run", "check", "declare", "datasets", "align", "verify", "tune", "compare", "report",
    "simulate", "demo",
)  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status.

    Whatever certnav refuses knowingly is one line on standard error and status 1.
    """
    # A run makes many objects that stay and few cycles: looking for those takes a tenth of it.
    gc.set_threshold(100_000)
    atexit.register(gc.freeze)  # and again at the end, where all of it goes anyway
    # All matrices are small or narrow: further threads of the linear algebra would only spin.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = parser().parse_args(argv)
    try:
        status = arguments.run(arguments)
    except NavError as error:
        print(f"certnav: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        print(f"certnav: {name}{error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("certnav: interrupted; nothing was written", file=sys.stderr)
        return 130
    return int(status or 0)


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    whole = argparse.ArgumentParser(
        prog="certnav",
        description="Loosely coupled GNSS/INS navigation of road vehicles.",
    )
    commands = whole.add_subparsers(required=True, metavar="COMMAND")
    for name in COMMANDS:
        module = importlib.import_module(f".{name}", __package__)
        command = commands.add_parser(name, help=module.HELP, description=module.DESCRIPTION)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return whole


if __name__ == "__main__":
    sys.exit(main())
