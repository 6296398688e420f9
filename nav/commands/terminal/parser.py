"""A command line that names the nearest known word where one is mistyped."""

from __future__ import annotations

import argparse
import difflib
import re
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """A parser whose errors say what may have been meant, and where the help is."""

    def known(self, arguments: list[str] | None) -> argparse.Namespace:
        """Return the arguments; what no parser knows is refused by that of the command."""
        parsed, rest = self.parse_known_args(arguments)
        if rest:
            command: Parser = getattr(parsed, "parser", self)
            command.error(f"unrecognized arguments: {' '.join(rest)}")
        return parsed

    def error(self, message: str) -> NoReturn:
        """End with status 2, in one line and a hint; the usage of ten lines hides both."""
        hint = self._hint(message)
        self.exit(2, f"{self.prog}: {message}{hint}\n{self.prog} --help says what there is\n")

    def _hint(self, message: str) -> str:
        words, choices = self._mistyped(message)
        for word in words:
            near = difflib.get_close_matches(word, choices, n=1, cutoff=0.6)
            if near:
                return f" — did you mean {near[0]}?"
        return ""

    def _mistyped(self, message: str) -> tuple[list[str], list[str]]:
        """Return the words that were not known, and those that are."""
        if found := re.match(r"unrecognized arguments: (.*)", message):
            options = [word.partition("=")[0] for word in found[1].split() if word[:1] == "-"]
            return options, list(self._option_string_actions)
        if found := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            return [found[1]], re.findall(r"[^\s',]+", found[2])
        return [], []
