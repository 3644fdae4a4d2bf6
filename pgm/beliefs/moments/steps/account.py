"""The account of a plan's sweeps: whether machine code made them, and why not."""

from __future__ import annotations

from dataclasses import dataclass, field

from pgm.compile.machine import CALLED


@dataclass(eq=False)
class Account:
    """The sweeps of a plan, of its parts and its windows so far.

    `due` says whether machine code was asked for, or would have repaid its loading; else `rest` is
    why not. `compiled` counts the sweeps that it made; `left` has the reasons why NumPy made
    others, and in how many runs at the most, or zero for all. `called` has the CPDs whose functions
    machine code has called, and why it does not have them itself. `on_card` says whether a card
    made some.
    """

    due: bool = False
    rest: str = ""
    compiled: int = 0
    left: dict[str, int] = field(default_factory=dict)
    called: dict[str, str] = field(default_factory=dict)
    on_card: bool = False

    def leave(self, why: str, runs: int = 0) -> None:
        """Note that a sweep, or some of its runs, are left to NumPy."""
        self.left[why] = max(self.left.get(why, 0), runs)

    def call_back(self, name: str, why: str) -> None:
        """Note that machine code calls the function of the CPD of a variable."""
        self.called[name] = why

    def words(self, runs: int) -> str:
        """The account in words, of so many runs."""
        if not self.due:
            return f"by NumPy: {self.rest}" if self.rest else ""
        card = ", on a card" if self.on_card else ""
        called = card + "".join(f", {name} {CALLED}{why}" for name, why in self.called.items())
        if not self.left:
            return f"compiled{called}" if self.compiled else ""
        told = "; ".join(
            f"{why} in {count} of {runs} runs" if count and runs > 1 else why
            for why, count in self.left.items()
        )
        return f"compiled{called}, but for: {told}" if self.compiled else f"not compiled: {told}"
