"""What the sources of the package say of families of beliefs, by their syntax trees."""

import ast
import importlib
import re
from functools import cache
from pathlib import Path
from types import ModuleType

import pgm
from pgm.beliefs.own.family import BeliefFamily
from pgm.posteriors.figures import Figures
from pgm.posteriors.outcome import Outcome

PACKAGE = Path(pgm.__file__).parent
# Modules that may name a family, and why.
MAY_NAME = {
    "pgm": "hands out public names",
    "pgm.inference": "hands out public names",
    "pgm.inference.families": "picks the family where none is given",
    "pgm.inference.old_names": "stands for classes of the version before",
}
# Modules that compare the names of functions, or of other libraries' classes.
MAY_COMPARE = {"pgm.arguments", "pgm.boundary", "pgm.evidence.records", "pgm.tracing.reads"}
NAMES = {"beliefs", "__name__", "__qualname__", "__class__"}
ASKING = {"isinstance", "issubclass"}
EQUAL = ast.Eq | ast.NotEq | ast.Is | ast.IsNot | ast.In | ast.NotIn
SUMS = {"einsum", "tensordot", "dot", "matmul", "inner", "vdot", "kron"}


@cache
def parsed(source):
    """The syntax of a source, parsed once for all checks."""
    return ast.parse(source)


@cache
def nodes(source):
    """All nodes of a source, found once for all checks."""
    return tuple(ast.walk(parsed(source)))


@cache
def modules():
    """The names and sources of all modules."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        name = ".".join(parts).removesuffix(".__init__")
        found.append((name, path.read_text(encoding="utf-8")))
    return found


def bound(tree):
    """The values that a module imports, at its top, in functions or for type checking, by name."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "pgm":
                    found[alias.asname or alias.name] = importlib.import_module(alias.name)
                    found.setdefault("pgm", pgm)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "pgm":
            source = importlib.import_module(node.module)
            for alias in node.names:
                if not hasattr(source, alias.name):
                    importlib.import_module(f"{node.module}.{alias.name}")
                found[alias.asname or alias.name] = getattr(source, alias.name)
    return found


def value(node, names):
    """The value of a name or of an attribute of an imported module; None of anything else."""
    if isinstance(node, ast.Name):
        return names.get(node.id)
    if isinstance(node, ast.Attribute):
        owner = value(node.value, names)
        return getattr(owner, node.attr, None) if isinstance(owner, ModuleType) else None
    return None


def of_one_family(found):
    """Whether a value is a family, its class or its module; their base is of all families."""
    if isinstance(found, ModuleType):
        own = re.fullmatch(r"pgm\.beliefs\.\w+\.family", found.__name__)
        return bool(own) and found.__name__ != BeliefFamily.__module__
    if isinstance(found, type):
        bases = {base for family in BeliefFamily.__subclasses__() for base in family.__mro__}
        return (
            found in bases
            and found.__module__.startswith("pgm.beliefs.")
            and not issubclass(BeliefFamily, found)
        )
    return isinstance(found, BeliefFamily)


def of_one_kind(found):
    """Whether a value is a class of one family's outcomes, figures or steps."""
    if not isinstance(found, type):
        return False
    return (issubclass(found, Outcome | Figures) and found not in (Outcome, Figures)) or (
        found.__module__.startswith("pgm.beliefs.") and found.__name__.endswith("Steps")
    )


def texts(node):
    """The strings in an expression."""
    return [n.value for n in ast.walk(node) if isinstance(n, ast.Constant) and type(n.value) is str]


def attributes(node):
    """The names of attributes in an expression."""
    return {n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute)}


def families():
    """The families of the package: classes, and what their beliefs are called."""
    found = [f for f in BeliefFamily.__subclasses__() if f.__module__.startswith("pgm.")]
    return {f.__name__ for f in found} | {f.beliefs for f in found}


def asked_kinds(module, source):
    """What a module outside the families asks of the kind of one."""
    tree, called = parsed(source), families()
    names = bound(tree)
    for name, found in names.items():
        if of_one_family(found):
            yield f"{module} imports {name}, of one family"
    for node in nodes(source):
        if isinstance(node, ast.Attribute) and of_one_family(value(node, names)):
            yield f"{module} names {ast.unparse(node)}, of one family"
        elif isinstance(node, ast.Constant) and type(node.value) is str:
            if re.fullmatch(r"pgm\.beliefs\.(?!own\b)\w+\.family", node.value):
                yield f"{module} names the module {node.value!r} of one family"
        elif isinstance(node, ast.Compare) and isinstance(node.ops[0], EQUAL):
            if module not in MAY_COMPARE and attributes(node) & NAMES:
                yield f"{module} compares a name: {ast.unparse(node)}"
            elif called & set(texts(node)):
                yield f"{module} compares with what a family is called: {ast.unparse(node)}"
            elif any(of_one_kind(value(n, names)) for n in ast.walk(node)):
                yield f"{module} compares a class: {ast.unparse(node)}"
        elif isinstance(node, ast.MatchValue) and called & set(texts(node)):
            yield f"{module} matches what a family is called: {ast.unparse(node)}"
        elif isinstance(node, ast.MatchClass) and of_one_kind(value(node.cls, names)):
            yield f"{module} matches a class: {ast.unparse(node)}"
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in ASKING:
            kinds = [n for n in ast.walk(node.args[1]) if of_one_kind(value(n, names))]
            yield from (f"{module} asks for a class: {ast.unparse(node)}" for _ in kinds)


@cache
def classes():
    """The classes of the package, by module and name, with the names that each defines."""
    return [
        ((module, node.name), defined(node))
        for module, source in modules()
        for node in nodes(source)
        if isinstance(node, ast.ClassDef)
    ]


def defined(node):
    """The attributes that a class defines: in its body, or in methods as ``self.name``."""
    found = {n.name for n in node.body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)}
    for each in ast.walk(node):
        targets = [*getattr(each, "targets", ()), getattr(each, "target", None)]
        for target in targets:
            if isinstance(target, ast.Name) and each in node.body:
                found.add(target.id)
            if isinstance(target, ast.Attribute) and getattr(target.value, "id", "") == "self":
                found.add(target.attr)
    return found


def overloads(source):
    """The lines of a module that name `typing.overload`, in whatever spelling."""
    for node in nodes(source):
        if (isinstance(node, ast.ImportFrom) and any(a.name == "overload" for a in node.names)) or (
            isinstance(node, ast.Attribute) and node.attr == "overload"
        ):
            yield node.lineno


def sums_of_products(source):
    """The functions of a module that multiply arrays and sum the product, by name."""
    for function in nodes(source):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            products = {
                target.id
                for node in ast.walk(function)
                if isinstance(node, ast.Assign | ast.AugAssign) and multiplies(node)
                for target in getattr(node, "targets", [getattr(node, "target", None)])
                if isinstance(target, ast.Name)
            }
            if any(is_sum(node, products) for node in ast.walk(function)):
                yield function.name


def multiplies(node):
    """Whether the value of an expression or assignment is a product of arrays."""
    node = node.value if isinstance(node, ast.Assign) else node
    return isinstance(getattr(node, "op", None), ast.Mult) or (
        isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "multiply"
    )


def is_sum(node, products):
    """Whether an expression sums a product, or one of the names `products`."""
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.MatMult)
    if not isinstance(node, ast.Call):
        return False
    called = getattr(node.func, "attr", getattr(node.func, "id", ""))
    if called in SUMS:
        return True
    if called not in ("sum", "reduce", "nansum"):
        return False
    summed = [*node.args[:1], getattr(node.func, "value", None)]
    return any(
        multiplies(n) or (isinstance(n, ast.Name) and n.id in products)
        for each in summed
        if each is not None
        for n in ast.walk(each)
    )


def said(source):
    """The strings of a module, docstrings apart, as patterns: what is filled in is anything."""
    told = {id(n.value) for n in nodes(source) if isinstance(n, ast.Expr)}
    joined = [n for n in nodes(source) if isinstance(n, ast.JoinedStr)]
    inside = {id(part) for n in joined for part in ast.walk(n)} - {id(n) for n in joined}
    for node in nodes(source):
        if id(node) in told or id(node) in inside:
            continue
        if isinstance(node, ast.Constant) and type(node.value) is str:
            yield node.value
        elif isinstance(node, ast.JoinedStr):
            yield "".join(
                part.value if isinstance(part, ast.Constant) else "{}" for part in node.values
            )
