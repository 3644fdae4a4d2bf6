"""NVIDIA's cards as a target: kernels printed as PTX, the assembly language that drivers take.

LLVM prints it. Elementary functions are those of libdevice, NVIDIA's library of them in LLVM's own
bitcode, of which the functions that are called are copied into the module. A kernel runs once a
*thread*, on so many numbers at once as a module of one lane has: one. Threads are numbered over the
*blocks* in which they are launched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgm.kernels.machine.emitter.kinds import symbol
from pgm.kernels.machine.emitter.processor import llvm

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.code import Code
    from pgm.kernels.machine.emitter.module import Module
    from pgm.kernels.machine.emitter.wholes import Address, Whole

_TRIPLE = "nvptx64-nvidia-cuda"
# Compute capabilities, and the versions of PTX that they came with, which their drivers know.
_VERSIONS = {(7, 5): 63, (8, 0): 70, (8, 6): 71, (8, 9): 78, (9, 0): 78}
OLDEST = min(_VERSIONS)
# Where libdevice lies among NVIDIA's packages.
_LIBRARIES = (
    "cuda_nvcc/nvvm/libdevice/libdevice.10.bc",
    "cu13/nvvm/libdevice/libdevice.10.bc",
)
# Parts of a thread's number: its block, the threads of a block, and its number in its block.
_PLACE = ("ctaid", "ntid", "tid")


@dataclass(frozen=True)
class Card:
    """A card, as a `Target`: by its compute capability, from `OLDEST` on.

    PTX for an older one runs on a newer one: beyond the newest that is known, it is for that.
    """

    capability: tuple[int, int]

    def __post_init__(self) -> None:
        if self.capability < OLDEST:
            told, least = (".".join(map(str, each)) for each in (self.capability, OLDEST))
            raise ValueError(
                f"code is printed for cards of compute capability {least} and later, not of {told}"
            )

    exported = "define ptx_kernel"
    # One float each: a thread has no vectors. More than so many in use would lie in memory.
    registers = 1, 32

    def scalar_function(self, name: str) -> str:
        """The symbol of libdevice's function of a name in C."""
        return f"__nv_{name}"

    def vector_function(self, name: str, arguments: int, lanes: int) -> tuple[str, int] | None:
        """There is none for packs."""
        return None

    def pointed(self, address: Address) -> Address:
        """An address that has been read from memory, marked as one of the card's own memory."""
        code = address.code
        # By way of a whole number, since two casts that undo each other are forgotten.
        number = code.value(f"ptrtoint ptr {address.text} to i64")
        there = code.value(f"inttoptr i64 {number} to ptr addrspace(1)")
        text = code.value(f"addrspacecast ptr addrspace(1) {there} to ptr")
        return type(address)(code, text)

    @property
    def arguments(self) -> dict[str, Any]:
        """The description of this card for LLVM."""
        major, minor = known = max(each for each in _VERSIONS if each <= self.capability)
        return {"cpu": f"sm_{major}{minor}", "features": f"+ptx{_VERSIONS[known]}"}


def thread(code: Code) -> Whole:
    """The number of the thread at hand, over all blocks of a launch."""
    block, size, own = (_register(code, f"llvm.nvvm.read.ptx.sreg.{place}.x") for place in _PLACE)
    return block * size + own


def _register(code: Code, name: str) -> Whole:
    code.module.declare(f"declare i32 @{name}()")
    narrow = code.value(f"call i32 @{name}()")
    return type(code.whole(0))(code, code.value(f"zext i32 {narrow} to i64"))


def printed(module: Module, kernels: Sequence[str], level: int = 2) -> str:
    """The kernels of a module for a card as PTX, optimised at a level as of `Module.compile`.

    Raises an ImportError where libdevice is due and not installed.
    """
    target = module.target
    assert isinstance(target, Card)
    machine = _target().create_target_machine(**target.arguments, opt=level)
    layout = f'target datalayout = "{machine.target_data}"\ntarget triple = "{_TRIPLE}"'
    text = module.text()
    whole = llvm().parse_assembly(f"{layout}\n{text}")
    tuning = llvm().create_pipeline_tuning_options(speed_level=level)
    builder = llvm().create_pass_builder(machine, tuning)
    if "@__nv_" in text:
        library = llvm().parse_bitcode(libdevice().read_bytes())
        library.data_layout, library.triple = whole.data_layout, whole.triple
        whole.link_in(library)
        # All but the kernels is theirs alone, and what they do not call goes at once.
        entries = set(map(symbol, kernels))
        for function in whole.functions:
            if not function.is_declaration and function.name not in entries:
                function.linkage = "internal"
        unused = llvm().create_new_module_pass_manager()
        unused.add_global_dead_code_eliminate_pass()
        unused.run(whole, builder)
    whole.verify()
    builder.getModulePassManager().run(whole, builder)
    found: str = machine.emit_assembly(whole)
    return found


def libdevice() -> Path:
    """Where NVIDIA's library of elementary functions lies.

    Raises an ImportError where it is not installed.
    """
    places = getattr(find_spec("nvidia"), "submodule_search_locations", None) or ()
    for place in places:
        for library in _LIBRARIES:
            if (path := Path(place) / library).is_file():
                return path
    raise ImportError(
        "code for a card takes NVIDIA's libdevice, which is not installed: "
        "pip install 'sepset[gpu]'"
    )


@cache
def _target() -> Any:
    llvm().initialize_all_targets()
    llvm().initialize_all_asmprinters()
    return llvm().Target.from_triple(_TRIPLE)
