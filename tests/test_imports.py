"""Imports inside pgm point one way, and `import pgm` stays light."""

import ast
import re
from functools import cache
from pathlib import Path

import networkx as nx
import pytest

PACKAGE = Path(__file__).parents[1] / "pgm"
LAYERS = [
    {
        *("arguments", "boundary", "display", "errors", "immutable", "progress", "resources"),
        *("units", "variables", "workers", "kernels"),
    },
    {"factors", "tracing"},
    {"linearisers"},
    {"cpds", "maps"},
    {"linearisation"},
    {"evidence"},
    {"networks"},
    {"clustergraph"},
    {"compile"},
    {"posteriors"},
    {"schedules", "elimination"},
    {"beliefs"},
    {"inference"},
    {"learning"},
    {"io", "consistency", "comparison", "plot", "recordings", "results", "viewer", "examples"},
]
HEIGHT = {name: height for height, layer in enumerate(LAYERS) for name in layer}


# The folders of a folder, each of which imports from those before it; files beside them are above.
ROOMS = {
    "pgm.beliefs": (
        *("points", "own", "gaussian", "moments", "modes", "discrete", "markov", "mixed"),
        *("hypotheses", "grid", "particles"),
    ),
    "pgm.beliefs.moments": (
        *("steps", "compiled", "passes", "trajectories", "digits", "smoothers"),
        *("association", "outcomes", "bound", "solvers", "parts", "online"),
    ),
    "pgm.inference": ("audit", "gaps", "query", "growing", "vouching"),
    "pgm.kernels.machine": (
        *("emitter", "matrices", "fronts", "sweeps", "newton", "studies", "particles"),
    ),
    "pgm.kernels.machine.matrices": ("in_memory",),
    "pgm.kernels.machine.sweeps": ("told",),
    "pgm.plot": ("drawing", "beliefs", "diagrams", "moving", "statistics"),
    "pgm.recordings": ("drives", "readers"),
}


MODULE = re.compile(r"pgm(\.[A-Za-z_]\w*)+")
LOADERS = {"import_module", "__import__", "find_spec", "run_module", "resolve_name"}
# Loads optional packages, which its callers name; what these name is looked at as theirs.
FREE = {"pgm.resources"}


def imported(tree, package):
    """List what a module imports: at its top, in a function, for type checking, or by a string."""
    found = named(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = [node.module] if node.module else []
            if node.level:
                parts = package.split(".")
                base = parts[: len(parts) - node.level + 1] + base
            if base == ["pgm"]:  # from pgm import factors
                found += [f"pgm.{alias.name}" for alias in node.names]
            else:
                found.append(".".join(base))
    return found


def named(tree):
    """List the strings of a module that are the name of one of the package, docstrings apart."""
    told = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            told.add(node.value)
    strings = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return [
        node.value
        for node in strings
        if node not in told and isinstance(node.value, str) and MODULE.fullmatch(node.value)
    ]


def hidden(tree):
    """List the calls that load a module whose whole name is not written out, as of a variable."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            given = node.args[0] if node.args else None
            text = getattr(given, "value", None)
            if name in LOADERS and (not isinstance(text, str) or text.startswith(".")):
                yield ast.unparse(node)


def faults(source, module):
    """List what a module, like ``pgm.factors.scope``, must not import."""
    own, tree = module.split(".")[1], ast.parse(source)
    found = []
    if module not in FREE:
        found += [f"{module} loads what it does not name: {call}" for call in hidden(tree)]
    for name in imported(tree, module.rpartition(".")[0]):
        parts = name.split(".")
        if parts[0] != "pgm":
            continue
        other = parts[1] if len(parts) > 1 else ""
        if other not in HEIGHT:
            found.append(f"{module} imports {name}, which is in no layer")
        elif own == "kernels" and other != "kernels":
            found.append(f"{module} imports {name}; kernels know nothing but kernels")
        elif HEIGHT[other] > HEIGHT[own]:
            found.append(f"{module} imports {name}, from a layer above")
    return found


def modules():
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        if parts != ("pgm", "__init__"):
            yield path, ".".join(parts)


def test_imports_point_one_way():
    found = [fault for path, name in modules() for fault in faults(path.read_text(), name)]
    assert not found, "\n".join(found)


def importing(sources):
    """The graph of the modules that import each other, of texts by name, lazily too."""
    graph = nx.DiGraph()
    for name, source in sources.items():
        for node in ast.walk(running(ast.parse(source))):
            if isinstance(node, ast.ImportFrom) and node.module:
                whole = [f"{node.module}.{alias.name}" for alias in node.names]
                found = [each if each in sources else node.module for each in whole]
            elif isinstance(node, ast.Import):
                found = [alias.name for alias in node.names]
            else:
                continue
            graph.add_edges_from((name, other) for other in found if other in sources)
    return graph


def circles(graph):
    """List the modules, or folders, that import each other."""
    return [sorted(circle) for circle in nx.strongly_connected_components(graph) if len(circle) > 1]


def folded(graph, sources):
    """The graph of folders; a package is in its own, and modules of pgm itself are one each."""
    packages = {name.rpartition(".")[0] for name in sources} - {"pgm"}

    def room(name):
        above = name.rpartition(".")[0]
        return name if name in packages or above == "pgm" else above

    pairs = ((room(name), room(other)) for name, other in graph.edges)
    return nx.DiGraph([pair for pair in pairs if pair[0] != pair[1]])


def running(tree):
    """Leave out what is for type checking alone."""
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and any(map(is_type_checking, ast.walk(node.test))):
            node.body = []
    return tree


def is_type_checking(node):
    return "TYPE_CHECKING" in (getattr(node, "id", ""), getattr(node, "attr", ""))


@cache
def whole():
    """The texts of all modules by name, and the graph of what they import."""
    texts = {name.removesuffix(".__init__"): path.read_text() for path, name in modules()}
    return texts, importing(texts)


def test_no_module_imports_one_that_imports_it():
    assert not circles(whole()[1])


def test_no_folder_imports_one_that_imports_it():
    texts, graph = whole()
    assert not circles(folded(graph, texts))


@pytest.mark.parametrize("parent", ROOMS)
def test_folders_import_those_before_them(parent):
    rooms, (texts, graph) = ROOMS[parent], whole()
    inside = [name for name in texts if name.startswith(f"{parent}.")]
    place = {}
    for name in inside:
        room, *rest = name.removeprefix(f"{parent}.").split(".")
        if rest or (PACKAGE.parent / name.replace(".", "/") / "__init__.py").exists():
            assert room in rooms, f"{name} is in a folder without a place"
            place[name] = rooms.index(room)
    found = [
        f"{name} imports {other}, from a folder above"
        for name, other in graph.edges
        if name in place and other in inside and place.get(other, len(rooms)) > place[name]
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from pgm.a import x", [["pgm.a", "pgm.b"]]),
        ("def f():\n    from pgm import a", [["pgm.a", "pgm.b"]]),
        ("import pgm.a", [["pgm.a", "pgm.b"]]),
        ("if TYPE_CHECKING:\n    from pgm.a import x", []),
        ("import numpy", []),
    ],
)
def test_the_check_finds_circles(source, found):
    assert circles(importing({"pgm.a": "from pgm.b import y", "pgm.b": source})) == found


@pytest.mark.parametrize(
    ("texts", "found"),
    [
        ({"pgm.a": "from pgm.a.b.c import x", "pgm.a.b.c": "from pgm.a.d import y"}, 1),
        ({"pgm.a.b": "from pgm.e.f import x", "pgm.e.g": "import pgm.a.c", "pgm.a.c": ""}, 1),
        ({"pgm.a": "from pgm.a.b.c import x", "pgm.a.b.c": "from pgm.d import y"}, 0),
    ],
)
def test_the_check_finds_circles_of_folders(texts, found):
    texts = {"pgm.a.d": "", "pgm.d": "", "pgm.e.f": "", "pgm.a.b": "", **texts}
    graph = importing(texts)
    assert not circles(graph)
    assert len(circles(folded(graph, texts))) == found


def test_every_module_has_a_layer():
    names = {name.split(".")[1] for _, name in modules()}
    assert names <= set(HEIGHT)
    assert {"kernels", "factors", "inference"} <= names


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("pgm.factors.scope", "import pgm.inference"),
        ("pgm.factors.scope", "from pgm.cpds import CPD"),
        ("pgm.factors.scope", "from pgm import linearisers"),
        ("pgm.factors.scope", "from pgm import Gaussian"),
        ("pgm.factors.scope", "def f():\n    from ..networks import checks"),
        ("pgm.factors.scope", "if TYPE_CHECKING:\n    from pgm.cpds import CPD"),
        ("pgm.kernels.roots", "from pgm.errors import ModelError"),
        ("pgm.kernels.roots", "from ..factors.scope import Scope"),
        ("pgm.inference.result", "from pgm import io"),
        ("pgm.inference.result", "import pgm\ndef f():\n    return pgm.plot.network"),
        ("pgm.display.shown", "def f():\n    import pgm.plot.diagrams"),
        ("pgm.display.shown", "def f():\n    return import_module('pgm.plot.diagrams.notebook')"),
        ("pgm.display.shown", "import importlib\nimportlib.import_module('pgm.plot')"),
        ("pgm.display.shown", "LATER = 'pgm.plot'\ndef f():\n    return import_module(LATER)"),
        ("pgm.display.shown", "LATER = {'pgm.plot': ('network',)}"),
        ("pgm.display.shown", "def f(name):\n    return import_module(f'pgm.{name}')"),
        ("pgm.display.shown", "def f(name):\n    return import_module('pgm.' + name)"),
        ("pgm.display.shown", "def f():\n    return __import__('pgm.plot')"),
        ("pgm.display.shown", "def f(a):\n    return __import__(a, fromlist=['b'])"),
        ("pgm.display.shown", "import_module('.plot', 'pgm')"),
        ("pgm.display.shown", "plot = sys.modules['pgm.plot']"),
    ],
)
def test_the_check_finds_faults(module, source):
    assert faults(source, module)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("pgm.networks.dynamic_sampling", "from pgm.cpds import CPD\nimport numpy"),
        (
            "pgm.networks.dynamic_sampling",
            "if TYPE_CHECKING:\n    from pgm.networks.dynamic import DynamicBayesianNetwork",
        ),
        ("pgm.kernels.roots", "from .arrays import Array"),
        ("pgm.variables", "from pgm.errors import ModelError"),
        ("pgm.plot.networks", "from pgm.inference import Posterior"),
        ("pgm.viewer.view", "files('pgm.viewer')"),
        ("pgm.factors.scope", '"""See `pgm.plot`."""\nimport_module(\'numpy\')'),
        ("pgm.factors.scope", "raise ValueError('pgm.plot.network(model) draws it')"),
        ("pgm.resources", "def optional(module):\n    return import_module(module)"),
    ],
)
def test_the_check_lets_the_rest_pass(module, source):
    assert not faults(source, module)
