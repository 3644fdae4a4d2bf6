"""Machine code by LLVM: `emitter` writes it, `loops` has matrices in memory, `sweeps` chains."""
