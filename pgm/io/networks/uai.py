"""Networks and evidence from the UAI format of inference competitions."""

from __future__ import annotations

import math

from pgm.errors import ModelError
from pgm.io.networks import sources
from pgm.io.networks.assembly import AXES, Assembly
from pgm.io.networks.sources import LIMIT, Source
from pgm.io.networks.uai_words import Words
from pgm.networks import BayesianNetwork
from pgm.variables import Discrete


def read_uai(source: Source, *, normalise: bool = False, limit: int = LIMIT) -> BayesianNetwork:
    """The network of a UAI file of the type BAYES.

    Such a file has no names: variables are called by their indices, ``"0"``, ``"1"``, ..., and so
    are their states. A table's last variable is the child, and its states move fastest. Comments,
    from ``#`` to the end of a line, are skipped.

    Parameters
    ----------
    source : str, Path or open file
        A path, or a file opened as text or as bytes; gzipped or not.
    normalise : bool, optional
        As of `read_bif`.
    limit : int, optional
        As of `read_bif`.

    Returns
    -------
    BayesianNetwork
        Its variables are `Discrete`, and in the order of their indices as far as parents before
        children allow.

    Raises
    ------
    FileError
        If the file is no such network; the message names the line, what was found, what to do.
    OSError
        If the file cannot be opened.

    References
    ----------
    UAI 2008 Workshop, Evaluation of probabilistic inference systems: file format.
    """
    content = sources.read(source, limit)
    words = Words(content, heading=True)
    assembly = Assembly(words.fault, normalise=normalise, limit=limit)
    count = words.count("the number of variables")
    sizes = [words.count("a number of states") for _ in range(count)]
    if 0 in sizes:
        words.fail(f"the variable {sizes.index(0)} has no states", sizes.index(0) + 1)
    assembly.expect(count + sum(sizes), 0)
    functions = words.count("the number of tables")
    if functions != len(sizes):
        words.fail(f"{functions} tables of {len(sizes)} variables; each has one", words.at - 1)
    scopes = []
    for _ in range(functions):
        start = words.at
        scope = [words.count("an index") for _ in range(words.count("the number of variables"))]
        if not 1 <= len(scope) <= AXES or max(scope) >= len(sizes):
            words.fail(
                f"a table of {len(scope)} variables, of {len(sizes)} in all; it is of 1 to {AXES}, "
                f"which count from 0 to {len(sizes) - 1}",
                start,
            )
        scopes.append((scope, start))
    orphan = next(iter(set(range(len(sizes))) - {scope[-1] for scope, _ in scopes}), None)
    if orphan is not None:
        words.fail(f"no table has the variable {orphan} as its child, the last one named", 0)
    tables = []
    for scope, _ in scopes:
        due = math.prod(sizes[k] for k in scope)
        found = words.count("the number of probabilities")
        if found != due:
            words.fail(
                f"{found} probabilities of the variable {scope[-1]} where {due} are due, one for "
                "each combination of states",
                words.at - 1,
            )
        tables.append((words.at, words.take(due)))
    words.finish()
    # Only now: the file holds as many numbers as its variables have states.
    for k, size in enumerate(sizes):
        assembly.declare(str(k), tuple(map(str, range(size))), k + 1)
    for (scope, start), (first, table) in zip(scopes, tables, strict=True):
        *given, child = map(str, scope)
        family = assembly.family(child, given, start)
        assembly.reserve(family)
        size = family.child.size
        places = range(first, words.at, size)
        assembly.table(family, table.reshape(-1, size), places.__getitem__)
    return assembly.network()


def read_uai_evidence(
    source: Source, network: BayesianNetwork, *, limit: int = LIMIT
) -> dict[Discrete, int]:
    """The evidence of a UAI file, for a network that `read_uai` read.

    Parameters
    ----------
    source : str, Path or open file
        Its numbers are how many variables are observed, then an index and a state of each; files
        of before 2010 say first that this is one sample.
    network : BayesianNetwork
        Whose variables the indices are the names of.
    limit : int, optional
        How many bytes the file may hold, once unpacked.

    Returns
    -------
    dict
        The index of the state of each variable that is observed.

    Raises
    ------
    FileError
        If the file is no such evidence; the message names the line, what was found, what to do.
    ModelError
        If the network is none.
    """
    if not isinstance(network, BayesianNetwork):
        raise ModelError(
            "read_uai_evidence takes the BayesianNetwork that the evidence is of, not "
            f"{type(network).__name__}"
        )
    words = Words(sources.read(source, limit), heading=False)
    observed = words.count("the number of variables observed")
    # One sample that is announced leaves an odd count of numbers, where pairs leave an even one.
    if observed == 1 and words.left % 2:
        observed = words.count("the number of variables observed")
    if words.left != 2 * observed:
        words.fail(
            f"{words.left} numbers follow where {2 * observed} are due, an index and a state of "
            f"each of {observed} variables; one sample is read, not several",
            words.at - 1,
        )
    variables = {v.name: v for v in network.variables if isinstance(v, Discrete)}
    evidence: dict[Discrete, int] = {}
    for _ in range(observed):
        name, state = str(words.count("an index")), words.count("a state")
        variable = variables.get(name)
        if variable is None:
            words.fail(f"the network has no variable {name}; is it that of read_uai?", words.at - 2)
        if state >= variable.size:
            words.fail(
                f"the variable {name} has the states 0 to {variable.size - 1}, not {state}",
                words.at - 1,
            )
        if evidence.setdefault(variable, state) != state:
            words.fail(f"the variable {name} is observed in two states; keep one", words.at - 1)
    return evidence
