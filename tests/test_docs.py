"""Commands that README and docs quote exist, with their options; pages link to what is there."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

import pytest

from certnav.nav.commands.cli import parser

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")


def pages():
    return pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def quoted(page: Path, start: str) -> list[str]:
    """Return the commands in code that begin so: of blocks line by line, and of `…` in text."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"```(?:console|sh|bash)\n(.*?)```", text, re.DOTALL)
    rest = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    code = "\n".join([*blocks, *re.findall(r"(?m)^    (\S.*)$", rest)])
    lines = [line.removeprefix("$ ") for line in code.replace("\\\n", " ").splitlines()]
    lines += re.findall(r"`([^`\n]+)`", rest)
    return [re.split(r" +# ", line)[0].strip() for line in lines if line.startswith(start)]


def subcommands() -> dict[str, argparse.ArgumentParser]:
    (chosen,) = (a for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    return dict(chosen.choices)


def known(command: argparse.ArgumentParser) -> set[str]:
    """Return the options of a command and of what is below it."""
    out: set[str] = set()
    for action in command._actions:
        out |= set(action.option_strings)
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                out |= known(below)
    return out


@pages()
def test_certnav_commands_and_their_options_exist(page):
    commands = subcommands()
    for line in quoted(page, "certnav "):
        name = line.split()[1]
        if name.startswith("-"):
            continue
        assert name in commands, f"{page.name}: {line}"
        unknown = set(_OPTION.findall(line)) - known(commands[name])
        assert not unknown, f"{page.name}: {line}: {unknown}"


@pages()
def test_settings_quoted_with_set_are_known(page):
    from certnav.nav.config_files import load_config

    for line in quoted(page, "certnav "):
        words = shlex.split(line.replace("…", ""))
        for setting in words[words.index("--set") + 1 :] if "--set" in words else []:
            if re.fullmatch(r"[a-z]+\.\w+=[^A-Z\[|]+", setting):
                load_config(None, [setting])


@pages()
def test_scripts_and_their_options_exist(page):
    for line in quoted(page, "python "):
        words = line.split()
        if not words[1].endswith(".py"):
            continue
        script = ROOT / words[1]
        assert script.is_file(), f"{page.name}: {line}"
        source = script.read_text(encoding="utf-8")
        unknown = {o for o in _OPTION.findall(line) if f'"{o}"' not in source}
        assert not unknown, f"{page.name}: {line}: {unknown}"


@pages()
def test_links_and_files_named_exist(page):
    text = page.read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text)
    missing = [x for x in links if "://" not in x and not (page.parent / x).exists()]
    named = re.findall(
        r"`((?:tests|scripts|docs|examples|nav|datasets|filters)/[\w/]+\.\w+)`", text
    )
    missing += [x for x in named if not (ROOT / x).exists()]
    assert not missing, f"{page.name}: {missing}"


def test_every_page_can_be_reached_from_the_readme():
    reached, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in reached:
            continue
        reached.add(page)
        links = re.findall(r"\]\(([^)#\s]+\.md)", page.read_text(encoding="utf-8"))
        waiting += [(page.parent / x).resolve() for x in links if "://" not in x]
    assert {p.name for p in PAGES} <= {p.name for p in reached}
