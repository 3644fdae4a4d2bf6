"""Functions of numbers as machine code, for one run or for a pack of runs at once.

A `Module` holds functions, each written as a `Code`: numbers in registers, numbers in memory,
loops and branches. Modules write LLVM's assembly language as text and compile it once. So is the
norm of many points, eight of them at once::

    module = Module()
    code = module.function("norms", [ADDRESS, ADDRESS, ADDRESS, WHOLE], lanes=8)
    x, y, norms, packs = code.arguments
    with code.loop(packs) as pack:
        norm = code.memory(x).load(pack).apply("hypot", code.memory(y).load(pack))
        code.memory(norms).store(pack, norm)
    function = module.compile().callable("norms")

Compiling loads llvmlite; importing pgm does not.
"""
