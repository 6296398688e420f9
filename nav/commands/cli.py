"""The command line: the table of commands, and how errors end.

Each command is a module of this folder with ``HELP`` (its line in ``certnav --help``),
``DESCRIPTION``, ``EXAMPLE``, ``add_arguments(parser)`` and ``run(arguments)``, which returns the
exit status or nothing. Whatever takes time to import is imported in ``run``.
"""

from __future__ import annotations

import argparse
import atexit
import contextlib
import gc
import importlib
import logging
import os
import sys
from collections.abc import Iterator

from ...filters.errors import NavError
from .terminal.parser import Parser
from .terminal.progress import silent

#: In the order of ``certnav --help``.
COMMANDS = (
    "run", "check", "declare", "datasets", "great", "align", "verify", "study", "tune", "compare",
    "report", "simulate", "demo", "allan",
)  # fmt: skip


#: How commands end, as ``certnav --help`` has it.
STATUS = """exit status:
  0    done
  1    refused in one line on standard error: nothing was written; of check: a fatal finding;
       of great: a recording or a step failed, the pages say which
  2    the command line itself is wrong
  3    run: the solution was lost and not found again; the result says where
  130  interrupted: nothing was written"""


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status.

    Whatever certnav refuses knowingly is one line on standard error and status 1.
    """
    # A run makes many objects that stay and few cycles: looking for those takes a tenth of it.
    gc.set_threshold(100_000)
    atexit.register(gc.freeze)  # and again at the end, where all of it goes anyway
    # All matrices are small or narrow: further threads of the linear algebra would only spin.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = _parsed(parser(), argv)
    if arguments.verbose:
        level = logging.INFO if arguments.verbose == 1 else logging.DEBUG
        logging.basicConfig(level=level, format="certnav: %(message)s", stream=sys.stderr)
        logging.getLogger("certnav").setLevel(level)
    try:
        with _quiet(arguments):
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


def _parsed(whole: Parser, argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line; or, where the shell asks what may follow, answer that and end."""
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete

        argcomplete.autocomplete(whole)
    return whole.known(argv)


@contextlib.contextmanager
def _quiet(arguments: argparse.Namespace) -> Iterator[None]:
    """With ``-q`` say nothing but errors; what is asked for as JSON is no chatter."""
    if not arguments.quiet:
        yield
        return
    with silent():
        if getattr(arguments, "json", False):
            yield
        else:
            with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
                yield


class _Version(argparse.Action):
    """Print the version, which is looked up only then."""

    def __init__(self, option_strings: list[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"certnav {version('certnav')}")
        parser.exit()


def _add_common(parser: argparse.ArgumentParser, default: object) -> None:
    """Add what all commands have; `default` keeps what stood before the command."""
    parser.add_argument(
        "-q", "--quiet", action="store_true", default=default or False, help="say errors only"
    )
    parser.add_argument(
        "-v", "--verbose", action="count", default=default or 0,
        help="say on standard error what takes how long; -vv: more",
    )  # fmt: skip


def parser() -> Parser:
    """Return the parser of all commands."""
    whole = Parser(
        prog="certnav",
        description="Loosely coupled GNSS/INS navigation of road vehicles.",
        epilog=STATUS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action=_Version)
    _add_common(whole, None)
    commands = whole.add_subparsers(required=True, metavar="COMMAND")
    for name in COMMANDS:
        module = importlib.import_module(f".{name}", __package__)
        command = commands.add_parser(
            name, help=module.HELP, description=module.DESCRIPTION,
            epilog=f"example: {module.EXAMPLE}",
        )  # fmt: skip
        module.add_arguments(command)
        _add_common(command, argparse.SUPPRESS)
        command.set_defaults(run=module.run, parser=command)
    return whole


if __name__ == "__main__":
    sys.exit(main())
