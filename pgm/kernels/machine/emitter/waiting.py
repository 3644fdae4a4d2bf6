"""Functions that wait: they give back to their caller in the middle, who goes on with them later.

LLVM calls them coroutines. Until a function that waits is gone on with, its variables are kept in a
*frame*, memory of its caller's. A frame is as large as `Waiting` has told, and is forgotten as any
other memory is: a function that is not gone on with leaves nothing behind.
"""

from __future__ import annotations

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.processor import llvm
from pgm.kernels.machine.emitter.wholes import Address, Whole

# Frames begin at multiples of so many bytes, which are those of the widest pack.
ALIGNED = 64
_DECLARED = (
    "declare token @llvm.coro.id(i32, ptr, ptr, ptr)",
    "declare i64 @llvm.coro.size.i64()",
    "declare ptr @llvm.coro.begin(token, ptr)",
    "declare i8 @llvm.coro.suspend(token, i1)",
)


def _kind_of_end() -> str:
    """The type in LLVM of what an end gives: up to some version a truth, which says nothing."""
    return "i1" if llvm().llvm_version_info < (22,) else "void"


class Waiting:
    """The way in which a function waits, made before anything else in it.

    The module's function has to be made as one that waits. Called with no `frame`, it writes how
    many bytes one has to the address `size`, and does nothing else.
    """

    def __init__(self, code: Code, frame: Address, size: Address) -> None:
        self._code = code
        self._end = f"{_kind_of_end()} @llvm.coro.end"
        for declaration in (*_DECLARED, f"declare {self._end}(ptr, i1, token)"):
            code.module.declare(declaration)
        (self._back,) = code.labels("back")
        nothing = "ptr null, ptr null, ptr null"
        begun = code.value(f"call token @llvm.coro.id(i32 {ALIGNED}, {nothing})")
        count = Whole(code, code.value("call i64 @llvm.coro.size.i64()"))
        with code.when(frame.is_null()):
            code.wholes(size).store(0, count)
            code.give()
        self._frame = code.value(f"call ptr @llvm.coro.begin(token {begun}, ptr {frame.text})")

    def wait(self) -> None:
        """Give back to the caller; the code after this runs once it goes on with the function."""
        code, (on,) = self._code, self._code.labels("on")
        state = code.value("call i8 @llvm.coro.suspend(token none, i1 false)")
        code.line(f"switch i8 {state}, label %{self._back} [i8 0, label %{on}]")
        code.begin(on)

    def end(self) -> None:
        """End the function, which has to be its last code."""
        code = self._code
        code.to(self._back)
        code.begin(self._back)
        code.line(f"call {self._end}(ptr {self._frame}, i1 false, token none)")


def go_on(code: Code, frame: Address) -> None:
    """Go on with the function that waits with a frame, until it waits again, or ends."""
    code.module.declare("declare void @llvm.coro.resume(ptr)")
    code.line(f"call void @llvm.coro.resume(ptr {frame.text})")
