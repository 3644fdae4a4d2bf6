"""Machine code written by LLVM: functions of numbers, for one run or for a pack of runs at once.

A `Module` holds functions, each written as a `Code`: numbers in registers, numbers in memory,
loops and branches. Modules write LLVM's assembly language as text and compile it once; only
compiling imports llvmlite.
"""
