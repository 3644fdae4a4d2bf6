"""The steps of a chain are written once: no other function of the package has their formulas."""

import ast
from functools import cache
from pathlib import Path

import pytest

import pgm

PACKAGE = Path(pgm.__file__).parent


def functions(source, *words):
    """The functions, as trees, of a file in which one of some words stands."""
    if any(word in source for word in words):
        yield from (each for each in ast.walk(ast.parse(source)) if is_function(each))


def is_function(node):
    return isinstance(node, ast.FunctionDef)


@cache
def everywhere(find):
    """Where in the package a function finds names in a source: the file, and the name."""
    paths = ((path.relative_to(PACKAGE).as_posix(), path) for path in PACKAGE.rglob("*.py"))
    return {(place, name) for place, path in paths for name in find(path.read_text("utf-8"))}


# ---- a sum of squares, (I − A) P (I − A)ᵀ

# Distances with their mean taken off, and a projection: neither has a gain.
OTHERS = {("viewer/placing.py", "_stressed"), ("kernels/rows.py", "_eliminate_exact")}


def sandwiches(source):
    """The names of functions that write (I − A) P (I − A)ᵀ: one minus A, used on both sides."""
    for function in functions(source, "one_minus", "eye("):
        kept = {
            target.id
            for line in ast.walk(function)
            if isinstance(line, ast.Assign) and is_one_minus(line.value)
            for target in line.targets
            if isinstance(target, ast.Name)
        }
        found = (e for e in ast.walk(function) if isinstance(e, ast.Call | ast.BinOp))
        if any(is_sandwich(each, kept) for each in found):
            yield function.name


def is_one_minus(node):
    """Whether an expression is `….one_minus()`, `one_minus(…)` or `….eye(…) - …`."""
    if isinstance(node, ast.Call):
        return getattr(node.func, "attr", getattr(node.func, "id", "")) == "one_minus"
    return (
        isinstance(node, ast.BinOp)
        and isinstance(node.op, ast.Sub)
        and isinstance(node.left, ast.Call)
        and getattr(node.left.func, "attr", getattr(node.left.func, "id", "")) == "eye"
    )


def is_sandwich(node, kept):
    """Whether a product has a name of `kept` on both sides, or is a call `sandwich(kept, …)`."""
    if isinstance(node, ast.Call):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        first = node.args and isinstance(node.args[0], ast.Name) and node.args[0].id in kept
        inside = isinstance(node.func, ast.Attribute) and names(node.func.value) & kept
        return bool(first and (name == "sandwich" or inside))
    if not isinstance(node.op, ast.MatMult):
        return False
    return bool(names(node.left) & names(node.right) & kept)


def names(node):
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}


# Bounds of rounding, and expected squares.
OF_BOUNDS = {
    ("beliefs/moments/digits/careful_belief.py", "through"),
    ("beliefs/moments/digits/adjoint_belief.py", "past"),
    ("learning/gaussian.py", "_left"),
}


def sums(source, least=2):
    """The names of functions that write A P Aᵀ + B R Bᵀ; or, at `least` one, A P Aᵀ + N."""
    for function in functions(source, ".T", ".mT", ".times(", "sandwich("):
        every = (e for e in ast.walk(function) if isinstance(e, ast.BinOp))
        added = (e for e in every if isinstance(e.op, ast.Add))
        if any(squared(e.left) + squared(e.right) >= least for e in added):
            yield function.name


def predictions(source):
    """The names of functions that write A P Aᵀ + N."""
    yield from sums(source, 1)


def squared(node):
    """Whether an expression is A P Aᵀ: `A @ P @ A.T`, `(A @ P).times(A)`, or `sandwich(A, P)`."""
    product = end = None
    if isinstance(node, ast.BinOp) and isinstance(node.right, ast.Attribute):
        if node.right.attr in {"T", "mT"}:
            product, end = node.left, node.right.value
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        if node.func.attr == "times":
            product, end = node.func.value, node.args[0]
    elif isinstance(node, ast.Call):
        return getattr(node.func, "id", "") == "sandwich"
    matmul = isinstance(product, ast.BinOp) and isinstance(product.op, ast.MatMult)
    return matmul and ast.unparse(product.left) == ast.unparse(end)


def test_a_sum_of_squares_is_written_once():
    assert everywhere(sandwiches) == OTHERS
    assert everywhere(sums) == {("kernels/step.py", "squares_by")}


def test_a_prediction_is_written_once():
    found = everywhere(predictions) - everywhere(sums) - OF_BOUNDS
    assert found == {("kernels/step.py", "predict")}


@pytest.mark.parametrize(
    "lines",
    [
        "keep = np.eye(3) - gain @ matrix\n    return keep @ cov @ keep.T",
        "keep = one_minus(multiply(gain, matrix))\n    return sandwich(keep, cov)",
        "k = (g @ h).one_minus()\n    return (k @ p).times(k)",
        "keep = np.eye(3) - gain[..., None] * row\n    return keep @ cov @ keep.mT + own",
    ],
)
def test_another_is_found(lines):
    assert list(sandwiches(f"def twice(gain, matrix, cov):\n    {lines}\n")) == ["twice"]


@pytest.mark.parametrize(
    "line",
    [
        "keep @ cov @ keep.mT + gain @ other @ gain.mT",
        "(keep @ cov).times(keep) + (gain @ other).times(gain)",
        "sandwich(keep, cov) + sandwich(gain, other)",
    ],
)
def test_another_of_any_matrices_is_found(line):
    assert list(sums(f"def twice(keep, gain, cov, other):\n    return {line}\n")) == ["twice"]


@pytest.mark.parametrize("line", ["noise + wide @ covs[of] @ wide.mT", "(f @ p).times(f) + noise"])
def test_another_prediction_is_found(line):
    source = f"def twice(f, p, wide, covs, of, noise):\n    return {line}\n"
    assert list(predictions(source)) == ["twice"]
    assert not list(sums(source))


# ---- the error of a regression, X W Xᵀ

# Weighed squares that are no error of a regression: of points and of residuals without values;
# eigenvalues; the information of scalars; expected counts.
OF_OTHERS = {
    *(("linearisers/points.py", "fault"), ("kernels/regression.py", "fit")),
    ("kernels/semidefinite.py", "semidefinite"),
    ("beliefs/moments/digits/careful_chain.py", "regular"),
    ("beliefs/moments/digits/careful_belief.py", "informed"),
    *(("learning/steps.py", "likeliest"), ("learning/steps.py", "at")),
}


def weighed_squares(source):
    """The names of functions that write Xᵀ W X with weights of its rows, as a regression has it."""
    for function in functions(source, ".T", ".mT", "transpose(", "swapaxes(", "einsum("):
        if any(is_weighed_square(each) for each in ast.walk(function)):
            yield function.name


def is_weighed_square(node):
    """Whether a product has a matrix on one side, and on the other the same times weights."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
        sides = node.left, node.right
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args:
        first = node.args[-2] if len(node.args) > 1 else node.func.value
        sides = first, node.args[-1]
        if node.func.attr not in {"dot", "times", "matmul", "einsum"}:
            return False
    else:
        return False
    for one, other in (sides, sides[::-1]):
        products = [n for n in ast.walk(other) if isinstance(n, ast.BinOp) and times(n)]
        if products:
            matrix = unturned(one)
            if any(matrix in parts(each) for each in products):
                return True
    return False


def times(node):
    """Whether an operation is a product of numbers."""
    return isinstance(node.op, ast.Mult)


def unturned(node):
    """The text of a matrix, or of what it is the transpose of."""
    if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "transpose":
        node = node.args[0]
    if isinstance(node, ast.Attribute) and node.attr in {"T", "mT"}:
        node = node.value
    return ast.unparse(node)


def parts(node):
    """The texts of the factors of a product of numbers."""
    return {ast.unparse(each) for each in (node.left, node.right)}


def test_the_error_of_a_regression_is_written_once():
    assert everywhere(weighed_squares) == OF_OTHERS


@pytest.mark.parametrize(
    "line",
    [
        "transpose(weights[:, None] * left) @ left",
        "(left if signs is None else signs[:, None] * left).T.dot(left)",
        'np.einsum("ikr,jkr->ijr", left if signs is None else signs[:, None] * left, left)',
        "transpose(left) @ (weights[:, None] * left)",
    ],
)
def test_another_regression_is_found(line):
    source = f"def twice(left, weights, signs):\n    return {line}\n"
    assert list(weighed_squares(source)) == ["twice"]


# ---- kinds of matrices

KINDS = {
    ("kernels/numbers.py", "Matrix"),
    *(("kernels/dense.py", name) for name in ("Dense", "Runs", "Stack")),
    ("kernels/machine/loops/stored.py", "Stored"),
    ("kernels/extended.py", "Twofold"),
}


def kinds(source):
    """The names of classes with products, and products that are symmetric, of their own."""
    for each in ast.walk(ast.parse(source)) if "__matmul__" in source else ():
        if isinstance(each, ast.ClassDef):
            methods = {line.name for line in each.body if isinstance(line, ast.FunctionDef)}
            if "__matmul__" in methods:
                yield each.name


def test_a_kind_of_matrices_is_written_once():
    assert everywhere(kinds) == KINDS
