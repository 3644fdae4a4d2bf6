"""The steps of a chain are written once: no other function of the package has their formulas.

A formula is looked for by its shape: products of matrices as `factors`, without transposes, in
whatever notation (`@`, `dot`, `einsum`, `times`, `sandwich`). Functions that are found, and have
something else in mind, are listed by name with what that is.
"""

import ast
from functools import cache
from pathlib import Path

import pytest

import pgm

PACKAGE = Path(pgm.__file__).parent
STEP = "kernels/step.py"


# ---- a function's formulas


@cache
def functions(source):
    """The functions of a file, as trees, each with all of its parts."""
    found = (each for each in ast.walk(ast.parse(source)) if isinstance(each, ast.FunctionDef))
    return [(each, list(ast.walk(each))) for each in found]


@cache
def everywhere(find):
    """Where in the package a function finds names in a source: the file, and the name."""
    paths = ((path.relative_to(PACKAGE).as_posix(), path) for path in PACKAGE.rglob("*.py"))
    return {(place, name) for place, path in paths for name in find(path.read_text("utf-8"))}


def found_in(source, is_found):
    """The names of the functions in which a part is found."""
    for function, parts in functions(source):
        if any(is_found(part, function) for part in parts):
            yield function.name


def called(node):
    """The name of a function that is called, and of what it is an attribute; or nothing."""
    if not isinstance(node, ast.Call):
        return "", ""
    if isinstance(node.func, ast.Attribute):
        return node.func.attr, named(node.func.value)
    return named(node.func), ""


def named(node):
    """The last name of an expression."""
    return getattr(node, "attr", getattr(node, "id", ""))


def is_method(function):
    return isinstance(function, ast.Attribute) and named(function.value) not in MODULES


PRODUCTS = {"dot", "times", "matmul", "multiply", "times_transposed", "times_symmetric", "apply"}
PRODUCTS |= {"einsum", "inner", "outer"}
MODULES = {"np", "arrays"}
TURNED = {"transpose", "swapaxes", "ascontiguousarray"}


def factors(node):
    """The factors of a product of matrices, without transposes; a single one of another."""
    if isinstance(node, ast.Attribute) and node.attr in {"T", "mT", "array"}:
        return factors(node.value)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
        return factors(node.left) + factors(node.right)
    name, _ = called(node)
    own = [node.func.value] if name and is_method(node.func) else []
    if name == "sandwich":
        outer, inner = map(factors, node.args)
        return outer + inner + outer
    if name in TURNED:
        return factors((own + node.args)[0])
    if name in PRODUCTS:
        matrices = [each for each in own + node.args if not isinstance(each, ast.Constant)]
        return [factor for each in matrices for factor in factors(each)]
    return [ast.unparse(node)]


def summed(node):
    """The sign and the two sides of a sum or a difference, in place too; or None."""
    name, _ = called(node)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
        return type(node.op), node.left, node.right
    if isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Add | ast.Sub):
        return type(node.op), node.target, node.value
    if name in {"add", "subtract"} and len(node.args) > 1:
        return {"add": ast.Add, "subtract": ast.Sub}[name], *node.args[:2]
    return None


# ---- the formulas


def predictions(source):
    """Functions that write A P Aᵀ + N, be it a prediction or a sum of squares."""

    def is_found(part, function):
        found = summed(part)
        if not found or found[0] is ast.Sub:
            return False
        return any(is_sandwich(factors_in(function, side)) for side in found[1:])

    return found_in(source, is_found)


def is_sandwich(product):
    """Whether factors are those of A P Aᵀ."""
    return len(product) > 2 and product[0] == product[-1]


@cache
def products(function):
    """The names of the products of matrices in a function, and their factors."""
    lines = (line for line in ast.walk(function) if isinstance(line, ast.Assign))
    found = {}
    for line in lines:
        if is_product(line.value):
            found |= {ast.unparse(to): factors(line.value) for to in line.targets}
    return found


def factors_in(function, node):
    """The factors of a product, also where a part of it has a name in the function."""
    names = products(function)
    return [each for factor in factors(node) for each in names.get(factor, [factor])]


def differences(source):
    """Functions that write P − P Hᵀ S⁻¹ H P, P − W Wᵀ or P − G H P."""

    def is_found(part, function):
        found = summed(part)
        if not found or found[0] is ast.Add:
            return False
        plain = factors(found[2])
        return any(
            len(product) > 1
            and (product[0] == product[-1] or {product[0], product[-1]} & {*factors(found[1])})
            for product in (plain, factors_in(function, found[2]))
        )

    return found_in(source, is_found)


def complements(source):
    """Functions that write (I − A) P, whatever comes after it."""

    def is_found(part, function):
        known = complementary(function)
        return known and is_product(part) and factors(part)[0] in known

    return found_in(source, is_found)


def is_product(node):
    return len(factors(node)) > 1


@cache
def complementary(function):
    """The names and expressions of I − A in a function."""
    found = set()
    for line in ast.walk(function):
        if is_one_minus(line):
            found.add(ast.unparse(line))
        if isinstance(line, ast.Assign) and is_one_minus(line.value):
            found |= {ast.unparse(target) for target in line.targets}
    return found


def is_one_minus(node):
    """Whether an expression is `….one_minus()`, `one_minus(…)` or `….eye(…) - …`."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub):
        return called(node.left)[0] in {"eye", "identity"}
    return called(node)[0] == "one_minus"


SOLVERS = {"solve", "cholesky", "inv", "pinv", "lstsq", "eigh", "eig", "svd", "qr", "slogdet"}
SOLVERS |= {"det", "solve_triangular", "cho_factor", "cho_solve", "ldl", "eigvalsh"}
OWN_SOLVERS = {"solve_lower", "solve_upper", "regression", "whiten", "regular_root"}


def solutions(source):
    """Functions that solve by matrices, or factorise them, without a `root`'s own methods."""

    def is_found(part, _):
        name, of = called(part)
        if name in OWN_SOLVERS or name.startswith(("dpotr", "dtrtr", "dposv", "dsyev")):
            return True
        return name in SOLVERS and of in {"linalg", "solving", "scipy", "lapack", ""}

    return found_in(source, is_found)


def gains(source):
    """Functions that write L⁻ᵀ (L⁻¹ C), the gain by a root."""

    def is_found(part, _):
        return called(part)[0] == "solve_transposed" and called(part.args[0])[0] == "solve"

    return found_in(source, is_found)


def factorisations(source):
    """Functions that subtract products of a matrix's own rows, one after another."""

    def is_found(part, _):
        return isinstance(part, ast.For | ast.comprehension) and any(
            is_own_product(each) for each in ast.walk(part)
        )

    return found_in(source, is_found)


def is_own_product(node):
    """Whether a product is of two parts of one array."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        product = [ast.unparse(node.left), ast.unparse(node.right)]
    else:
        product = factors(node) if isinstance(node, ast.BinOp | ast.Call) else []
    arrays = {factor.split("[")[0] for factor in product}
    parts = len(product) > 1 and len(set(product)) > 1 and all("[" in each for each in product)
    return parts and len(arrays) == 1 and "(" not in arrays.pop()


def turns(source):
    """Functions that round a number of whole turns."""
    whole = {"rint", "nearest_whole", "round", "floor", "mod", "remainder", "fmod", "around"}

    def is_found(part, _):
        if isinstance(part, ast.BinOp) and isinstance(part.op, ast.Mod | ast.FloorDiv):
            return any(map(is_turn, ast.walk(part.right)))
        name, _ = called(part)
        if name == "arctan2":
            return {called(each)[0] for each in part.args} == {"sin", "cos"}
        if name == "apply":
            name = getattr(part.args[0], "value", "")
        return name in whole and any(map(is_turn, ast.walk(part)))

    return found_in(source, is_found)


def is_turn(node):
    return named(node).strip("_") in {"TURN", "pi", "tau"}


def gaps(source):
    """Functions that put an identity in place of what is missing."""

    def is_found(part, _):
        eye = "eye", "identity", "_identity"
        return (
            called(part)[0] == "where"
            and len(part.args) == 3
            and any(called(each)[0] in eye or named(each) in eye for each in part.args[1:])
        )

    return found_in(source, is_found)


def weighed_squares(source):
    """Functions that write Xᵀ W X with weights W of rows, the error of a regression."""
    return found_in(source, lambda part, _: is_weighed_square(part))


def is_weighed_square(node):
    """Whether a product has a matrix on one side, and on the other the same times weights."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
        sides = node.left, node.right
    elif called(node)[0] in {"dot", "times", "matmul", "einsum"} and node.args:
        sides = (node.args[-2] if len(node.args) > 1 else node.func.value), node.args[-1]
    else:
        return False
    for one, other in (sides, sides[::-1]):
        products = (n for n in ast.walk(other) if isinstance(n, ast.BinOp))
        weighed = (n for n in products if isinstance(n.op, ast.Mult))
        parts = {ast.unparse(side) for each in weighed for side in (each.left, each.right)}
        if len(factors(one)) == 1 and factors(one)[0] in parts:
            return True
    return False


def kinds(source):
    """Classes with products of matrices of their own."""
    for each in ast.walk(ast.parse(source)) if "__matmul__" in source else ():
        if isinstance(each, ast.ClassDef):
            methods = {line.name for line in each.body if isinstance(line, ast.FunctionDef)}
            if "__matmul__" in methods:
                yield each.name


# ---- where each is, and what else has its shape

DIGITS = "beliefs/moments/digits/"


def listed(*groups):
    """Files and names, of groups that have the names by file."""
    every = (item for group in groups for item in group.items())
    return {(place, name) for place, names in every for name in names.split()}


PREDICTIONS = listed(
    {STEP: "crossed squares_by"},
    # Bounds of rounding, and expected squares of residuals.
    {f"{DIGITS}adjoint_belief.py": "past", f"{DIGITS}careful_belief.py": "through"},
    {"learning/gaussian.py": "_left", "learning/residuals.py": "rows"},
    # Information of two canonical forms.
    {"kernels/canonical.py": "combine"},
    # A member's smoothed belief, by a ratio; and the spread of a sighting under all candidates.
    {"kernels/merging.py": "_multiplied", "beliefs/hypotheses/sightings.py": "_within"},
)
DIFFERENCES = listed(
    # Factorisations, one number after another.
    {"kernels/numbers.py": "__init__", "kernels/machine/matrices/in_memory/roots.py": "root rows"},
    # Beliefs given what an adjoint pass says, which has no gain.
    {f"{DIGITS}adjoint.py": "_across", f"{DIGITS}adjoint_belief.py": "given"},
    # Information: what is left of it, and what has changed.
    {"kernels/canonical.py": "_backward_indefinite marginalise"},
    {"beliefs/gaussian/front_squares.py": "_eliminated"},
    {"kernels/row_messages.py": "_moved change", "kernels/elements.py": "compose"},
    # A projection, and squares of draws.
    {"kernels/rows.py": "_eliminate_exact _eliminate_proper"},
    {"beliefs/particles/guided_proposal.py": "steered"},
)
COMPLEMENTS = listed(
    # A transition given a measurement, and a projection.
    {"beliefs/moments/passes/messages.py": "absorb_readings"},
    {"kernels/rows.py": "_eliminate_exact"},
    # A ratio of densities, along one axis, for variances that it may widen.
    {"kernels/merging.py": "_multiplied"},
)
GAINS = listed({STEP: "gain reweighed after"})
FACTORISATIONS = listed(
    {"kernels/roots.py": "_semidefinite_root regular_root"},
    # The squares by which merged means differ, which are added up.
    {"kernels/machine/sweeps/mixture.py": "_merged add_cov"},
    # The covariances of draws.
    {"beliefs/modes/adapted.py": "_controlled", "beliefs/modes/recombined.py": "_kernels"},
)
# Beside the step: wrapping to [−π, π) with its end, and bins around a circle.
TURNS = listed({STEP: "turns"}, {"kernels/angles.py": "wrap", "kernels/bins.py": "keys"})
GAPS = listed(
    {"kernels/arrays.py": "independent", "kernels/dense.py": "independent"},
    # Of infinite variances, which do not count.
    {"linearisation/costs.py": "squares"},
    # Of a stack in which some have no elimination, and of hypotheses that are impossible.
    {"kernels/rows.py": "_eliminate_proper", "beliefs/hypotheses/unsound.py": "replaced"},
)
WEIGHED = listed(
    # Of points without values, and of eigenvalues.
    {"linearisers/points.py": "fault", "kernels/regression.py": "fit"},
    {"kernels/semidefinite.py": "semidefinite", f"{DIGITS}careful_chain.py": "regular"},
    # The information of scalars, expected counts, and distances.
    {f"{DIGITS}careful_belief.py": "informed", "learning/steps.py": "likeliest at"},
    {"viewer/placing.py": "_stressed", "factors/gaussian_mixture.py": "cov"},
)
KINDS = listed(
    {"kernels/numbers.py": "Matrix", "kernels/dense.py": "Dense Runs Stack"},
    {"kernels/machine/matrices/in_memory/stored.py": "Stored", "kernels/extended.py": "Twofold"},
)
# What solves or factorises but by the roots of `step`, which no update of a belief does.
SOLUTIONS = listed(
    # The roots of the kinds themselves, and equations of arrays by them.
    {"kernels/dense.py": "__init__ left solve solve_transposed"},
    {"kernels/solving.py": "_solve left_open regression solve whiten", "kernels/roots.py": "root"},
    {"kernels/semidefinite.py": "semidefinite"},
    # Densities, divergences and draws.
    {
        "kernels/moments.py": "_whitened kl mutual_information principal_axes",
        "factors/gaussian_mixture.py": "modes",
    },
    {"kernels/normal_density.py": "off whitened whitener", "factors/arrays.py": "covariance_fault"},
    {"kernels/sampled.py": "_whitened terms worth"},
    {"cpds/conditional.py": "_robust", "beliefs/points/laws.py": "log_density"},
    {"linearisation/weights.py": "of", "posteriors/innovations.py": "whitened"},
    {"consistency/errors.py": "_normalised", "consistency/ranking.py": "_by_sighting"},
    {"beliefs/particles/guided_proposal.py": "_whitened steered"},
    {"kernels/divergence.py": "from_gaussian"},
    # Covariances as they are given, in other axes.
    {"recordings/drives/spreads.py": "turned"},
    # Conditionals of Gaussians whose moments are those of draws; points of unit covariance.
    {"beliefs/modes/chain_laws.py": "_given", "beliefs/modes/points.py": "cut"},
    {"kernels/joint_compatibility.py": "__init__"},
    # The losses of merging, and the coordinates of what is learnt of what was merged.
    {"kernels/merging.py": "_losses _principal _whitening"},
    # Information: canonical forms, rows of square roots, elements of a scan, a reading's removal.
    {"beliefs/moments/outcomes/left_out.py": "left_out"},
    {"kernels/canonical.py": "_backward_indefinite _invertible_root _split backward combine"},
    {"kernels/canonical.py": "determined_moments from_affine from_moments marginalise"},
    {"kernels/canonical.py": "squares to_moments"},
    {"kernels/rows.py": "_eliminate_proper _svd triangular"},
    {"kernels/elements.py": "_meet compose moved"},
    {"beliefs/gaussian/potentials.py": "_factor", "beliefs/gaussian/joints.py": "_gain"},
    {"beliefs/gaussian/relations.py": "_solved_for", "beliefs/gaussian/solving.py": "__call__"},
    {"beliefs/gaussian/refusals.py": "_open", "beliefs/gaussian/front_squares.py": "_eliminated"},
    {"inference/growing/tree.py": "cliques", "inference/growing/factors.py": "_roots"},
    {"inference/growing/covariances.py": "_made across"},
    {"beliefs/moments/passes/likelihoods.py": "of"},
    {"beliefs/moments/passes/messages.py": "likelihoods"},
    # Unknown directions, exact relations, bounds of rounding, and whether messages settle.
    {f"{DIGITS}careful_belief.py": "solved", f"{DIGITS}reversal_rounding.py": "injected"},
    {"beliefs/gaussian/walks.py": "spectral_radius", "beliefs/mixed/weighing.py": "_lost"},
    # The points of a rule, and the cells of a grid.
    {"kernels/regression.py": "_line fit range_inverse"},
    {"beliefs/grid/belief.py": "non_gaussianity", "beliefs/grid/groups.py": "parted"},
    {"beliefs/grid/sensors.py": "terms", "beliefs/grid/values.py": "deviations"},
    {"beliefs/grid/wide_prior.py": "wide"},
    # Trajectories side by side: the rotation between them, and rotations that are none.
    {"io/alignment.py": "relative umeyama", "io/kitti.py": "_require_rotations"},
    # Learning, recorded information, and pictures.
    {"learning/gaussian.py": "_by_row _least _regressed _require_noise gradient"},
    {"learning/steps.py": "__init__ _lower _rank at gradient likeliest maximised"},
    {
        "learning/residuals.py": "_expected _robust",
        "recordings/drives/pose_graph.py": "covariances",
    },
    {
        "beliefs/moments/outcomes/families.py": "_cut",
        "linearisation/nonlinearity.py": "nonlinearity",
    },
    {"plot/diagrams/layering.py": "along", "viewer/placing.py": "_stressed"},
    # A step of a control, whose function has the name `solve`.
    {"kernels/machine/sweeps/control.py": "step"},
)


@pytest.mark.parametrize(
    ("find", "due"),
    [
        *((predictions, PREDICTIONS), (differences, DIFFERENCES), (complements, COMPLEMENTS)),
        *((solutions, SOLUTIONS), (factorisations, FACTORISATIONS), (turns, TURNS), (gaps, GAPS)),
        *((weighed_squares, WEIGHED), (kinds, KINDS), (gains, GAINS)),
    ],
    ids=lambda each: getattr(each, "__name__", ""),
)
def test_each_step_is_written_once(find, due):
    assert everywhere(find) == due


OTHERS = [
    (predictions, "keep @ cov @ keep.mT + gain @ other @ gain.mT"),
    (predictions, "(keep @ cov).times(keep) + (gain @ other).times(gain)"),
    (predictions, "sandwich(keep, cov) + sandwich(gain, other)"),
    (predictions, "noise + wide @ covs[of] @ wide.mT"),
    (predictions, "matrix.dot(cov).dot(matrix.T) + noise"),
    (predictions, "np.add(np.einsum('ij,jk,lk->il', f, cov, f), noise)"),
    (predictions, "row @ cov @ row + variance"),
    (differences, "cov - np.outer(gain, row @ cov)"),
    (differences, "cov - gain @ spread @ gain.T"),
    (differences, "cov - gain @ matrix @ cov"),
    (differences, "cov - white.T @ white"),
    (differences, "np.subtract(cov, np.einsum('ki,kj->ij', white, white))"),
    (differences, "cov - (matrix @ cov).T @ solved @ matrix @ cov"),
    (complements, "(np.eye(3) - gain @ matrix) @ cov"),
    (complements, "(gain @ matrix).one_minus() @ cov"),
    (complements, "(gain @ matrix).one_minus().times(other)"),
    (solutions, "np.linalg.solve(spread, matrix @ cov).T"),
    (solutions, "residual @ np.linalg.solve(spread, residual)"),
    (solutions, "cov @ matrix.T @ inv(spread)"),
    (solutions, "scipy.linalg.cho_solve((lower, True), cross)"),
    (turns, "residual - 2.0 * np.pi * np.round(residual / (2.0 * np.pi))"),
    (turns, "(residual + np.pi) % (2.0 * np.pi) - np.pi"),
    (turns, "angle - _TURN * (angle / _TURN).apply('rint')"),
    (turns, "np.arctan2(np.sin(off), np.cos(off))"),
    (gains, "root.solve_transposed(root.solve(cross)).T"),
    (gaps, "np.where(known[:, None] & known, noise, np.eye(3))"),
    (weighed_squares, "transpose(weights[:, None] * left) @ left"),
    (weighed_squares, "(left if signs is None else signs[:, None] * left).T.dot(left)"),
    (weighed_squares, "np.einsum('ikr,jkr->ijr', signs[:, None] * left, left)"),
    (weighed_squares, "transpose(left) @ (weights[:, None] * left)"),
]


@pytest.mark.parametrize(("find", "line"), OTHERS)
def test_another_is_found(find, line):
    assert list(find(f"def twice(*given):\n    return {line}\n")) == ["twice"]


@pytest.mark.parametrize(
    ("find", "lines"),
    [
        (predictions, "cov = matrix @ cov @ matrix.T\n    cov += noise\n    return cov"),
        (predictions, "half = matrix @ cov\n    return half @ matrix.T + noise"),
        (differences, "cross = matrix @ cov\n    return cov - gain @ cross"),
        (complements, "keep = np.eye(3) - gain @ matrix\n    return keep @ cov @ keep.T"),
        (complements, "keep = one_minus(multiply(gain, matrix))\n    return sandwich(keep, cov)"),
        (differences, "cov -= gain @ spread @ gain.T"),
        (
            factorisations,
            "for i in range(3):\n        for j in range(i):\n            "
            "low[i, j] = (a[i, j] - low[i, :j] @ low[j, :j]) / low[j, j]",
        ),
    ],
)
def test_others_of_several_lines_are_found(find, lines):
    assert list(find(f"def twice(gain, matrix, cov, noise, a, low):\n    {lines}\n")) == ["twice"]
