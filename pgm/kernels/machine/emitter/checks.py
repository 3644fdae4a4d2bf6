"""Tests of indices and alignments while code runs; see `Module(checked=True)`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Address, Whole

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.code import Code

# The first fault's number, counted from 1, with the index and the length at fault.
FAULT = "first_fault"
_DECLARED = f"""@{FAULT} = global [3 x i64] zeroinitializer
define internal void @pgm.blame(i64 %fault, i64 %index, i64 %length) noinline nounwind {{
%old = load i64, ptr @{FAULT}
%first = icmp eq i64 %old, 0
br i1 %first, label %tell, label %end
tell:
store i64 %fault, ptr @{FAULT}
store i64 %index, ptr getelementptr (i64, ptr @{FAULT}, i64 1)
store i64 %length, ptr getelementptr (i64, ptr @{FAULT}, i64 2)
br label %end
end:
ret void
}}"""


def check_index(code: Code, index: Whole | int, length: Whole | int | None, access: str) -> None:
    """Give back with a fault where an index lies outside memory of this length."""
    index = code.whole(index)
    if length is None:
        _check(code, index, code.whole(0), f"{access}: index {{}} is negative", index < 0)
        return
    length = code.whole(length)
    told = f"{access}: index {{}} is outside its {{}} numbers"
    _check(code, index, length, told, (index < 0) | (index >= length))


def check_alignment(code: Code, address: Address, alignment: int, access: str) -> None:
    """Give back with a fault where an address is no multiple of an alignment."""
    if alignment == 1:
        return
    place = Whole(code, code.value(f"ptrtoint ptr {address.text} to i64"))
    told = f"{access}: address {{}} is no multiple of {{}}"
    _check(code, place, code.whole(alignment), told, place % alignment != 0)


def _check(code: Code, index: Whole, length: Whole, told: str, fault: Number) -> None:
    module = code.module
    module.declare(_DECLARED)
    module.faults.append(f"{code.name}: {told}")
    number = len(module.faults)
    values = f"i64 {number}, i64 {index.text}, i64 {length.text}"
    code.stop(fault, lambda: code.line(f"call void @pgm.blame({values})"))
