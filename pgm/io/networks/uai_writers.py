"""Networks of tables to the UAI format, and answers as the inference competitions ask for them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

import numpy as np

from pgm.arguments import public
from pgm.cpds import TableCPD
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError
from pgm.factors import Table
from pgm.factors.scope import names
from pgm.inference.query.asked import require_mapping
from pgm.inference.query.assignments import MostProbable
from pgm.io import sources
from pgm.io.sources import Source
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork, MarkovNetwork
from pgm.posteriors.posterior import Posterior
from pgm.variables import Discrete, Variable

# What is asked of a problem: the partition function, marginals, the most probable assignment.
TASKS = "PR", "MAR", "MAP", "MMAP"


@public
def write_uai(network: MarkovNetwork, target: Source) -> None:
    """Write a network of tables as UAI, which `read_uai` reads back to one of equal tables.

    A `BayesianNetwork` is of type BAYES, any other of type MARKOV. The format has no names: a
    variable is its index, which is its name where the variables are called ``"0"`` to ``"n - 1"``,
    as `read_uai` calls them, and else its place in ``network.variables``.

    Parameters
    ----------
    network : BayesianNetwork or MarkovNetwork
        Of discrete variables.
    target : str, Path or open file
        See `write_bif`.

    Raises
    ------
    FileError
        See `write_bif`.
    ModelError
        If the network is not of tables, or an entry of one is no number of float64: its log-scale
        is too large.

    Examples
    --------
    >>> import io
    >>> a, b = pgm.Discrete("a", 2), pgm.Discrete("b", 2)
    >>> file = io.StringIO()
    >>> pgm.write_uai(pgm.MarkovNetwork([pgm.Table((a, b), [[2.0, 1.0], [1.0, 2.0]])]), file)
    >>> print(file.getvalue())
    MARKOV
    2
    2 2
    1
    2 0 1
    <BLANKLINE>
    4
    2.0 1.0 1.0 2.0
    <BLANKLINE>
    """
    order = numbered(network, "write_uai")
    index = {variable: k for k, variable in enumerate(order)}
    factors = cast(Sequence[Table | TableCPD], network.factors)
    lines = [
        "BAYES" if isinstance(network, BayesianNetwork) else "MARKOV",
        str(len(order)),
        " ".join(str(v.size) for v in order),
        str(len(factors)),
    ]
    for factor in factors:
        axes = factor._potential.axes
        lines.append(" ".join(map(str, [len(axes), *(index[v] for v in axes)])))
    for factor in factors:
        values = entries(factor).ravel()
        lines += ["", str(values.size), " ".join(map(repr, values.tolist()))]
    sources.write(target, "\n".join(lines) + "\n")


@public
def write_uai_evidence(
    evidence: Mapping[Variable, Any], network: MarkovNetwork, target: Source
) -> None:
    r"""Write the evidence of a problem, which `read_uai_evidence` reads back.

    Parameters
    ----------
    evidence : mapping of Discrete
        The name or index of one state of each observed variable.
    network : BayesianNetwork or MarkovNetwork
        Variables are written by their indices as in `write_uai`.
    target : str, Path or open file
        See `write_bif`.

    Raises
    ------
    FileError
        See `write_bif`.
    EvidenceError
        If a variable is not the network's, or has no single state.

    Examples
    --------
    >>> import io
    >>> from pgm.examples import coin, side
    >>> file = io.StringIO()
    >>> pgm.write_uai_evidence({side: "tails"}, coin, file)
    >>> file.getvalue()
    '1 0 1\n'
    """
    order = numbered(network, "write_uai_evidence")
    require_mapping(evidence)
    index = {variable: k for k, variable in enumerate(order)}
    words = [len(evidence)]
    for variable, state in evidence.items():
        if not isinstance(variable, Discrete) or variable not in index:
            raise EvidenceError(
                f"write_uai_evidence: {variable!r} is not in the network",
                variable=variable if isinstance(variable, Variable) else None,
            )
        words += [index[variable], _state(variable, state)]
    sources.write(target, " ".join(map(str, words)) + "\n")


@public
def write_uai_result(
    task: str,
    answer: Any,
    network: MarkovNetwork,
    target: Source,
) -> None:
    """Write the answer to a problem of the inference competitions as they ask for it.

    Parameters
    ----------
    task : str
        ``"PR"``, log₁₀ of the partition function; ``"MAR"``, the marginals of all variables, of
        which those observed have all their probability in one state;
        ``"MAP"``, the most probable assignment; or ``"MMAP"``, that of some variables, in the order
        of the answer.
    answer : Posterior or MostProbable
        What `infer` found, of PR and MAR, or `most_probable`, of MAP and MMAP; of one run.
    network : BayesianNetwork or MarkovNetwork
        Variables are written by their indices as in `write_uai`.
    target : str, Path or open file
        See `write_bif`.

    Raises
    ------
    FileError
        See `write_bif`.
    ModelError
        If the task is none of these, or the answer is none to it, of several runs, or has other
        variables than the network.

    Examples
    --------
    >>> import io
    >>> from pgm.examples import rainy, wet
    >>> file = io.StringIO()
    >>> posterior = pgm.infer(pgm.compile(rainy), {wet: "yes"})
    >>> pgm.write_uai_result("MAR", posterior, rainy, file)
    >>> print(file.getvalue())
    MAR
    2 2 0.25 0.75 2 0.0 1.0
    <BLANKLINE>

    References
    ----------
    UAI 2014 inference competition: file formats.
    """
    if not isinstance(task, str) or task not in TASKS:
        raise ModelError(f"write_uai_result: the task is one of {', '.join(TASKS)}, not {task!r}")
    order = numbered(network, "write_uai_result")
    if task == "PR":
        found = _posterior(answer, task, order)
        words = [repr(_single(found.log_evidence, "log_evidence") / math.log(10.0))]
    elif task == "MAR":
        words = _marginals(_posterior(answer, task, order), order)
    else:
        words = _states(answer, task, order)
    sources.write(target, f"{task}\n{' '.join(words)}\n")


def numbered(network: MarkovNetwork, where: str) -> list[Discrete]:
    """The variables of a network of tables by their indices in its file."""
    if not isinstance(network, MarkovNetwork) or not network.discrete:
        raise ModelError(f"{where} takes a network of tables, not {titled(network)}")
    order = cast(list[Discrete], list(network.variables))
    by_name = {v.name: v for v in order}
    own = [by_name.get(str(k)) for k in range(len(order))]
    if None in own or any(v.step is not None for v in order):
        return order
    return cast(list[Discrete], own)


def entries(factor: Table | TableCPD) -> Array:
    """The entries of a factor as numbers; a ModelError where one is none of float64."""
    values, scale = factor._potential.values, factor._potential.log_scale
    if not scale:
        return values
    logs = factor.log_values if isinstance(factor, Table) else np.log(values)
    with np.errstate(over="ignore", under="ignore"):
        found: Array = np.exp(logs)
    # Numbers below the smallest normal one have lost digits.
    few = (found < np.finfo(np.float64).tiny) & np.isfinite(logs)
    if not np.isfinite(found).all() or few.any():
        raise ModelError(
            f"the factor over {names(factor.scope)} has the log-scale {scale:.6g}, and entries "
            "that are no numbers of float64, as a file has them; give it another log-scale"
        )
    return found


def _state(variable: Discrete, state: Any) -> int:
    try:
        return int(variable.index(state))
    except (ModelError, TypeError, ValueError):
        raise EvidenceError(
            f"write_uai_evidence: {variable!r} has one state, by name or index, not {state!r}",
            variable=variable,
        ) from None


def _single(value: Array, what: str) -> float:
    if np.shape(value):
        raise ModelError(
            f"a file holds the answer of one run, and this {what} is of the runs {np.shape(value)}"
        )
    return float(value)


def _posterior(answer: Any, task: str, order: Sequence[Discrete]) -> Posterior[Table]:
    """A posterior of the network whose variables are in `order`."""
    if not isinstance(answer, Posterior) or answer.kind is not None:
        raise _no_answer(task, "infer", answer)
    variables = answer.graph.network.variables
    _require_known(variables, order)
    if len(variables) < len(order):
        raise ModelError(
            f"write_uai_result: the network has {len(order)} variables, and that of the answer "
            f"{len(variables)}; give the network of the answer"
        )
    return answer


def _marginals(found: Posterior[Table], order: Sequence[Discrete]) -> list[str]:
    """The marginals of all variables, those observed with all probability in one state."""
    _single(found.log_evidence, "posterior")
    words, known = [str(len(order))], found._outcome.entered(0)
    for variable in order:
        state = known.get(variable)
        if state is None:
            shares = found[variable].probabilities
        else:
            shares = np.eye(variable.size)[variable.index(state)]
        words += [str(variable.size), *map(repr, shares.tolist())]
    return words


def _states(answer: Any, task: str, order: Sequence[Discrete]) -> list[str]:
    """The most probable states, of all variables or of those asked for."""
    if not isinstance(answer, MostProbable):
        raise _no_answer(task, "most_probable", answer)
    _single(answer.log_probability, "log_probability")
    found = cast(Mapping[Discrete, str], answer.assignment)
    _require_known(found, order)
    lacking = tuple(v for v in order if v not in found)
    if task == "MAP" and lacking:
        raise ModelError(
            f"write_uai_result: the answer is of {len(found)} of {len(order)} variables, without "
            f"{names(lacking)}; it is one to the task 'MMAP'"
        )
    asked = order if task == "MAP" else list(found)
    return [str(len(asked)), *(str(v.index(found[v])) for v in asked)]


def _no_answer(task: str, call: str, answer: Any) -> ModelError:
    return ModelError(
        f"write_uai_result: the answer to {task!r} is that of pgm.{call}, not {titled(answer)}"
    )


def _require_known(variables: Iterable[Variable], order: Sequence[Discrete]) -> None:
    known = set(order)
    for variable in variables:
        if variable not in known:
            raise ModelError(
                f"write_uai_result: the answer has {variable!r}, and the network has not; give "
                "the network of the answer",
                variable=variable,
            )
