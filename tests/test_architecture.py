"""The house is as it is drawn. Read from the sources alone: nothing of the package is imported.

Each rule takes the root of a checkout and returns what breaks it. `PLANTED` breaks each of them in
a small house that is otherwise sound, and sees that it is found.
"""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]

PACKAGES = ("nav", "alignment", "velocity", "datasets", "filters")
#: Imports go downwards only; '' is the front page.
ORDER = ("", *PACKAGES, "lazy")
#: What `datasets` may use of `filters`: the Earth, sensors, and the arithmetic around them.
SEEN_BY_DATASETS = {"compiled", "earth", "errors", "fault_exclusion", "rotation", "sensors"}
#: Inside `nav`, downwards only, too; neighbours do not know each other, with one exception:
#: comparing methods, `compare` also has the one that aligns windows.
NAV = (
    ("commands",),
    ("drafting",),
    ("check", "compare", "report", "study", "tune", "windows"),
    ("learned", "page", "results", "spells"),
    ("evaluation",),
    ("navigator", "pipeline"),
    ("engine",),
    ("_frames", "config_files", "rejections", "rest", "solution"),
    ("sweep",),
    ("config", "installation", "notes", "signals"),
    ("vehicles",),
)
NEIGHBOURS = {("compare", "windows")}
#: A folder is seen at a glance, a module read in one sitting.
MOST_MODULES, MOST_LINES = 15, 400


class Broken(NamedTuple):
    """What breaks a rule, and where: a path below the root, and a line or 0."""

    place: str
    line: int
    what: str


class Import(NamedTuple):
    """One imported module, or a name in it."""

    line: int
    module: str  # dotted, below the root: 'nav.compare.report'
    name: str  # '' where the module itself is imported
    for_types: bool  # only where TYPE_CHECKING


class Module(NamedTuple):
    """One module of the packages."""

    place: str
    name: str  # dotted, below the root; a package's is that of its folder, '' the root's
    package: str  # in which its relative imports begin
    text: str
    tree: ast.Module
    nodes: tuple[tuple[ast.AST, bool], ...]  # and whether they are for type checkers only


@cache
def modules(root: Path) -> dict[str, Module]:
    """Return all modules of a checkout's packages, by name."""
    files = [
        *root.glob("*.py"),
        *(f for package in PACKAGES for f in (root / package).rglob("*.py")),
    ]
    out = {}
    for path in sorted(files):
        place = path.relative_to(root)
        folder = ".".join(place.parts[:-1])
        name = folder if path.stem == "__init__" else f"{folder}.{path.stem}".lstrip(".")
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text, str(place))
        out[name] = Module(place.as_posix(), name, folder, text, tree, tuple(nodes(tree)))
    return out


@cache
def folders(root: Path) -> list[str]:
    """Return the folders with modules in them, dotted."""
    return sorted({module.package for module in modules(root).values()})


def nodes(tree: ast.Module) -> Iterator[tuple[ast.AST, bool]]:
    """Yield every node, and whether it is there for type checkers only."""
    waiting: list[tuple[ast.AST, bool]] = [(tree, False)]
    while waiting:
        node, for_types = waiting.pop()
        yield node, for_types
        only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        body = getattr(node, "body", []) if only else []
        waiting += [
            (child, for_types or child in body) for child in reversed([*ast.iter_child_nodes(node)])
        ]


@cache
def imports(root: Path, module: Module) -> tuple[Import, ...]:
    """Return what a module imports of the packages, in functions too."""
    return tuple(_imports(root, module))


def _imports(root: Path, module: Module) -> Iterator[Import]:
    known = modules(root)
    for node, for_types in module.nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                top, _, rest = alias.name.partition(".")
                if top == "certnav":
                    yield Import(node.lineno, rest, "", for_types)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = module.package.split(".")[: -(node.level - 1) or None]
                base = ".".join(filter(None, [*above, base]))
            elif base.partition(".")[0] == "certnav":
                base = base.partition(".")[2]
            else:
                continue
            for alias in node.names:
                inner = f"{base}.{alias.name}" if base else alias.name
                if inner in known:
                    yield Import(node.lineno, inner, "", for_types)
                else:
                    yield Import(node.lineno, base, alias.name, for_types)


def calls(module: Module, *names: str) -> Iterator[ast.Call]:
    """Yield the calls of functions and methods so written: 'print', 'os.replace', '.rename'."""
    last = {name.rpartition(".")[2] for name in names}
    for node, _ in module.nodes:
        if isinstance(node, ast.Call):
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            written = ast.unparse(node.func) if called in last else ""
            if written in names or (written and f".{called}" in names):
                yield node


def layers(root: Path) -> Iterator[Broken]:
    """Packages import downwards, and `datasets` of `filters` only what it needs."""
    for module in modules(root).values():
        mine = module.name.split(".")[0]
        for found in imports(root, module):
            theirs, _, inner = found.module.partition(".")
            if theirs not in ORDER or ORDER.index(theirs) < ORDER.index(mine):
                yield Broken(module.place, found.line, f"{mine} imports {theirs or 'certnav'}")
            elif (mine, theirs) == ("datasets", "filters"):
                used = inner.split(".")[0] or found.name
                if used not in SEEN_BY_DATASETS:
                    yield Broken(module.place, found.line, f"datasets imports filters.{used}")


def layers_of_nav(root: Path) -> Iterator[Broken]:
    """Inside `nav`, too."""
    rank = {unit: k for k, units in enumerate(NAV) for unit in units}
    for module in modules(root).values():
        top, _, inner = module.name.partition(".")
        mine = inner.split(".")[0]
        if top != "nav" or not mine:
            continue
        if mine not in rank:
            yield Broken(module.place, 0, f"nav.{mine} has no place in the order")
            continue
        for found in imports(root, module):
            package, _, inner = found.module.partition(".")
            theirs = inner.split(".")[0]
            if package != "nav" or theirs == mine or (mine, theirs) in NEIGHBOURS:
                continue
            if theirs not in rank or rank[theirs] <= rank[mine]:
                what = f"nav.{mine} imports nav.{theirs or found.name}"
                yield Broken(module.place, found.line, what)


def no_circles(root: Path) -> Iterator[Broken]:
    """No module imports itself by way of others, in functions neither."""
    known = modules(root)
    edges = {
        name: sorted({i.module for i in imports(root, m) if not i.for_types and i.module in known})
        for name, m in known.items()
    }
    done: set[str] = set()

    def visit(name: str, way: list[str]) -> Iterator[Broken]:
        if name in way:
            circle = way[way.index(name) :]
            first = circle.index(min(circle))
            circle = [*circle[first:], *circle[: first + 1]]
            yield Broken(known[circle[0]].place, 0, " → ".join(circle))
        elif name not in done:
            for following in edges[name]:
                yield from visit(following, [*way, name])
            done.add(name)

    for name in known:
        yield from visit(name, [])


def privates_stay_home(root: Path) -> Iterator[Broken]:
    """No package imports a module or a name of another that begins with an underscore."""
    for module in modules(root).values():
        for found in imports(root, module):
            parts = [*found.module.split("."), found.name]
            if parts[0] != module.name.split(".")[0] and any(p.startswith("_") for p in parts):
                yield Broken(module.place, found.line, ".".join(filter(None, parts)))


def only_commands_print(root: Path) -> Iterator[Broken]:
    """Nothing but a command prints, or knows of a command line."""
    for module in modules(root).values():
        if module.name.startswith("nav.commands"):
            continue
        for call in calls(module, "print"):
            yield Broken(module.place, call.lineno, "print")
        for node, _ in module.nodes:
            names = [alias.name for alias in getattr(node, "names", []) if hasattr(alias, "name")]
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            if isinstance(node, ast.Import | ast.ImportFrom) and "argparse" in names:
                yield Broken(module.place, node.lineno, "argparse")


def only_placing_moves(root: Path) -> Iterator[Broken]:
    """What is written in one move goes through one module."""
    for module in modules(root).values():
        if module.name != "datasets.placing":
            for call in calls(module, "os.replace", "os.rename", "shutil.move", ".rename"):
                yield Broken(module.place, call.lineno, ast.unparse(call.func))


def folders_seen_at_a_glance(root: Path) -> Iterator[Broken]:
    """No folder holds more modules than one keeps in mind."""
    for folder in folders(root):
        path = root.joinpath(*folder.split("."))
        count = sum(file.name != "__init__.py" for file in path.glob("*.py"))
        if count > MOST_MODULES:
            yield Broken(folder.replace(".", "/"), 0, f"{count} modules")


def modules_of_one_idea(root: Path) -> Iterator[Broken]:
    """No module is longer than one reads in one sitting."""
    for module in modules(root).values():
        lines = module.text.count("\n")
        if lines > MOST_LINES:
            yield Broken(module.place, 0, f"{lines} lines")


def wheel_has_all_folders(root: Path) -> Iterator[Broken]:
    """The packages that pyproject.toml names are the folders there are."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    named = set(project["tool"]["setuptools"]["packages"])
    there = {f"certnav.{folder}".rstrip(".") for folder in folders(root)}
    for name in sorted(named ^ there):
        what = "is no folder" if name in named else "is missing"
        yield Broken("pyproject.toml", 0, f"{name} {what}")


def relative_imports(root: Path) -> Iterator[Broken]:
    """Packages import each other relatively, whatever the checkout is called."""
    for module in modules(root).values():
        for node, _ in module.nodes:
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module or ""]
            for name in names:
                if name.split(".")[0] in ("certnav", *ORDER[1:]):
                    yield Broken(module.place, node.lineno, name)


def no_mutable_defaults(root: Path) -> Iterator[Broken]:
    """No function keeps what its callers put into a default."""
    mutable = (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp)
    makers = {"list", "dict", "set", "bytearray", "deque", "defaultdict", "Counter"}
    for module in modules(root).values():
        for node, _ in module.nodes:
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                continue
            for default in (*node.args.defaults, *node.args.kw_defaults):
                made = isinstance(default, ast.Call) and ast.unparse(default.func) in makers
                if isinstance(default, mutable) or made:
                    yield Broken(module.place, default.lineno, ast.unparse(default))


def folders_say_what_they_are(root: Path) -> Iterator[Broken]:
    """Every folder is a package with a docstring."""
    for folder in folders(root):
        package = modules(root).get(folder)
        if package is None or not ast.get_docstring(package.tree):
            yield Broken("/".join([*folder.split("."), "__init__.py"]), 0, "no docstring")


RULES: tuple[Callable[[Path], Iterator[Broken]], ...] = (
    layers, layers_of_nav, no_circles, privates_stay_home, only_commands_print, only_placing_moves,
    folders_seen_at_a_glance, modules_of_one_idea, wheel_has_all_folders, relative_imports,
    no_mutable_defaults, folders_say_what_they_are,
)  # fmt: skip


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_house_is_as_it_is_drawn(rule):
    found = list(rule(ROOT))
    assert not found, "\n".join(f"{b.place}:{b.line}: {b.what}" for b in found)


#: A small house in which nothing is wrong.
SOUND = {
    "lazy.py": "def names():\n    pass\n",
    "filters/earth.py": "RADIUS = 6.4e6\n",
    "filters/ekf.py": "from ..lazy import names\nfrom .earth import RADIUS\n",
    "datasets/sequence.py": "from ..filters.earth import RADIUS\n\ndef f(a=()):\n    return a\n",
    "datasets/placing.py": "import os\n\nos.replace('a', 'b')\n",
    "velocity/ddia.py": "from ..datasets import sequence\nfrom ..filters import earth, ekf\n",
    "alignment/verdict.py": "from ..velocity.ddia import sequence\n",
    "nav/config.py": "from ..datasets.sequence import f\n",
    "nav/engine/loop.py": "from ...alignment.verdict import sequence\nfrom ..config import f\n",
    "nav/results/directory.py": "from ..engine import loop\n",
    "nav/windows/recording.py": "from ..results.directory import loop\n",
    "nav/compare/runs.py": (
        "from typing import TYPE_CHECKING\n\nfrom ..windows.recording import loop\n"
        "\nif TYPE_CHECKING:\n    from .report import page\n"
    ),
    "nav/compare/report.py": "def page():\n    from .runs import loop\n",
    "nav/commands/cli.py": "import argparse\n\nfrom ..compare.report import page\n\nprint(page)\n",
}

MANY = {f"nav/engine/m{k}.py": "" for k in range(MOST_MODULES)}
#: Rule, what is added to the sound house, and where it is found.
PLANTED = [
    (layers, {"filters/ekf.py": "from ..datasets import sequence\n"}, "filters/ekf.py"),
    (layers, {"velocity/ddia.py": "import certnav.nav.config\n"}, "velocity/ddia.py"),
    (layers, {"alignment/verdict.py": "from ..nav.config import f\n"}, "alignment/verdict.py"),
    (layers, {"velocity/ddia.py": "from .. import version\n"}, "velocity/ddia.py"),
    (layers, {"lazy.py": "def f():\n    from .filters import earth\n"}, "lazy.py"),
    (layers, {"datasets/load.py": "from ..filters.ekf import RADIUS\n"}, "datasets/load.py"),
    (layers, {"datasets/load.py": "from ..filters import ekf\n"}, "datasets/load.py"),
    (layers, {"datasets/a.py": "def f():\n    from ..velocity import ddia\n"}, "datasets/a.py"),
    (layers_of_nav, {"nav/tune/a.py": "from ..compare.runs import loop\n"}, "nav/tune/a.py"),
    (layers_of_nav, {"nav/windows/a.py": "from ..compare import runs\n"}, "nav/windows/a.py"),
    (layers_of_nav, {"nav/engine/a.py": "from ..results import directory\n"}, "nav/engine/a.py"),
    (layers_of_nav, {"nav/utils.py": ""}, "nav/utils.py"),
    (layers_of_nav, {"nav/engine/a.py": "from .. import utils\n"}, "nav/engine/a.py"),
    (no_circles, {"nav/config.py": "def f():\n    from .engine import loop\n"}, "nav/config.py"),
    (no_circles, {"filters/earth.py": "from . import ekf\n"}, "filters/earth.py"),
    (no_circles, {"filters/a.py": "from . import a\n"}, "filters/a.py"),
    (
        privates_stay_home,
        {"filters/compiled/kernels.py": "", "nav/config.py": "from ..filters import _kernels\n"},
        "nav/config.py",
    ),
    (
        privates_stay_home,
        {"nav/config.py": "from ..filters.ekf import _limit\n"},
        "nav/config.py",
    ),
    (only_commands_print, {"nav/config.py": "def f():\n    print(1)\n"}, "nav/config.py"),
    (only_commands_print, {"nav/config.py": "def f():\n    import argparse\n"}, "nav/config.py"),
    (only_commands_print, {"nav/a.py": "from argparse import Namespace\n"}, "nav/a.py"),
    (only_placing_moves, {"nav/config.py": "import os\nos.replace('a', 'b')\n"}, "nav/config.py"),
    (only_placing_moves, {"nav/config.py": "def f(a):\n    a.b.rename('b')\n"}, "nav/config.py"),
    (folders_seen_at_a_glance, MANY, "nav/engine"),
    (modules_of_one_idea, {"nav/config.py": "\n" * (MOST_LINES + 1)}, "nav/config.py"),
    (wheel_has_all_folders, {"nav/tune/__init__.py": '"""New."""\n'}, "pyproject.toml"),
    (relative_imports, {"nav/config.py": "from certnav.filters import earth\n"}, "nav/config.py"),
    (relative_imports, {"nav/config.py": "def f():\n    import datasets\n"}, "nav/config.py"),
    (no_mutable_defaults, {"nav/config.py": "def f(a=[]):\n    pass\n"}, "nav/config.py"),
    (no_mutable_defaults, {"nav/config.py": "f = lambda *, a={1}: a\n"}, "nav/config.py"),
    (no_mutable_defaults, {"nav/config.py": "def f(a=dict()):\n    pass\n"}, "nav/config.py"),
    (folders_say_what_they_are, {"nav/engine/__init__.py": "x = 1\n"}, "nav/engine/__init__.py"),
    (folders_say_what_they_are, {"nav/tune/a.py": ""}, "nav/tune/__init__.py"),
]


def built(root: Path, changes: dict[str, str]) -> Path:
    """Build the sound house with some files changed or added."""
    places = {Path(name).parent for name in SOUND} | {Path("nav")}
    packages = sorted(".".join(["certnav", *place.parts]) for place in places)
    files = {str(place / "__init__.py"): '"""A room."""\n' for place in places}
    files["pyproject.toml"] = f"[tool.setuptools]\npackages = {packages}\n"
    for name, text in (files | SOUND | changes).items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return root


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_nothing_is_found_in_a_sound_house(rule, tmp_path):
    assert list(rule(built(tmp_path, {}))) == []
    assert rule in [planted[0] for planted in PLANTED]


@pytest.mark.parametrize(("rule", "changes", "place"), PLANTED)
def test_what_is_planted_is_found(rule, changes, place, tmp_path):
    found = list(rule(built(tmp_path, changes)))
    assert found and {broken.place for broken in found} == {place}, found
