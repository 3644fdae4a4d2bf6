"""Elementary functions, those of C or a card; of packs of a vector library where it is right."""

from __future__ import annotations

from pgm.kernels.machine.emitter.kinds import PACK, packed
from pgm.kernels.machine.emitter.numbers import Number, alike

# Functions of C neither write memory nor fail, so that equal calls are made once.
PURE = "nounwind willreturn memory(none)"


def elementary(name: str, *given: Number) -> Number:
    """The value of a function of C's, of one or two numbers."""
    given = alike(*given) if len(given) == 2 else (given[0].number(),)
    code, lanes = given[0].code, given[0].lanes
    if lanes == 1:
        symbol = code.module.target.scalar_function(name)
        return code.from_outside(symbol, list(given), "double", PURE)
    if lanes != code.lanes:  # and no function of these packs can be called
        return _of_pack(name, given)
    helper = code.module.helper(f"{name} of {lanes}", [PACK] * len(given), lanes)
    if helper.fresh:
        helper.code.give(_of_pack(name, helper.code.arguments))
    found: Number = code.call(helper.code, *given)
    return found


def _of_pack(name: str, given: tuple[Number, ...]) -> Number:
    lanes = given[0].lanes
    target = given[0].code.module.target
    known = target.vector_function(name, len(given), lanes)
    return _lane_by_lane(name, given) if known is None else _at_once(given, *known)


def _lane_by_lane(name: str, given: tuple[Number, ...]) -> Number:
    found = Number(given[0].code, "poison", given[0].lanes)
    for lane in range(found.lanes):
        found = found.with_lane(lane, elementary(name, *(each.lane(lane) for each in given)))
    return found


def _at_once(given: tuple[Number, ...], symbol: str, width: int) -> Number:
    """The values by a vector function of so many lanes, called once or more often."""
    code, lanes = given[0].code, given[0].lanes
    parts = []
    for first in range(0, lanes, width):
        part = [_part(each, first, width) for each in given]
        parts.append(code.from_outside(symbol, part, packed("double", width), PURE))
    while len(parts) > 1:
        parts = [_joined(*pair) for pair in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


def _part(pack: Number, first: int, width: int) -> Number:
    if width == pack.lanes:
        return pack
    return _shuffled(pack, pack, range(first, first + width))


def _joined(first: Number, second: Number) -> Number:
    return _shuffled(first, second, range(2 * first.lanes))


def _shuffled(first: Number, second: Number, places: range) -> Number:
    kind, lanes = first.kind, len(places)
    mask = f"<{lanes} x i32> <{', '.join(f'i32 {place}' for place in places)}>"
    two = f"{kind} {first.text}, {kind} {second.text}"
    return Number(first.code, first.code.value(f"shufflevector {two}, {mask}"), lanes)
