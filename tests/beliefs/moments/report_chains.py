"""A table of what the engine says of drawn networks, from one seed to another.

PYTHONPATH=.:tests/beliefs/moments python tests/beliefs/moments/report_chains.py 0 200
"""

import argparse
import time
from collections import Counter, defaultdict

import numpy as np
from drawn_chains import draw
from judged_chains import CATEGORIES, Judge


def table(verdicts, worst):
    kinds = list(dict.fromkeys(v.kind for _, v in verdicts))
    count = Counter((v.kind, v.category) for _, v in verdicts)
    lines = [f"{'':24}" + "".join(f"{c:>9}" for c in CATEGORIES)]
    lines += [f"{k:24}" + "".join(f"{count[k, c] or '·':>9}" for c in CATEGORIES) for k in kinds]
    for category in ("miss", "foreign", "refused", "told"):
        by_kind = defaultdict(list)
        for case, v in verdicts:
            if v.category == category:
                by_kind[v.kind].append((v.size, case.seed, v.words))
        for k, found in by_kind.items():
            found.sort(reverse=True, key=lambda f: f[:2])
            shown = ", ".join(
                f"{seed}" + (f" ({size:.1e})" if np.isfinite(size) else "")
                for size, seed, _ in found[:worst]
            )
            lines.append(f"{category} {k}: {shown}")
            lines += [
                f"      {n} × {w[:150]}"
                for w, n in Counter(f[2] for f in found if f[2]).most_common(2)
            ]
    return "\n".join(lines)


def structure(verdicts):
    """How often cases of a trait are missed, kind by kind."""
    missed = defaultdict(set)
    cases = {case.seed: case for case, _ in verdicts}
    for case, v in verdicts:
        if v.category in ("miss", "foreign"):
            missed[v.kind.split()[0]].add(case.seed)
    kinds = sorted(missed)
    traits = sorted({t for case in cases.values() for t in case.traits})
    lines = [f"{'':24}{'cases':>9}" + "".join(f"{k:>9}" for k in kinds)]
    for trait in traits:
        have = {s for s, case in cases.items() if trait in case.traits}
        lines.append(
            f"{trait:24}{len(have):>9}" + "".join(f"{len(missed[k] & have):>9}" for k in kinds)
        )
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--worst", type=int, default=8, help="seeds named of each kind")
    parser.add_argument("--verbose", action="store_true", help="every verdict of every case")
    arguments = parser.parse_args()
    begun, verdicts, skipped, rounded = time.perf_counter(), [], [], 0
    spent = 0.0
    for seed in range(arguments.first, arguments.last):
        case = draw(seed)
        started = time.perf_counter()
        judged = Judge(case)
        spent += time.perf_counter() - started
        rounded += judged.disagreement > 0
        if judged.disagreement > 1e-12:
            skipped.append(seed)
            continue
        found = judged.verdicts()
        verdicts += [(case, v) for v in found]
        if arguments.verbose:
            print(seed, case.steps, case.lead, sorted(case.traits))
            for v in found:
                print(f"    {v.kind:24}{v.category:9}{v.size:.2e} {v.words}")
    print(table(verdicts, arguments.worst))
    print(structure(verdicts))
    took = time.perf_counter() - begun
    cases = arguments.last - arguments.first
    print(
        f"{cases} cases in {took:.0f} s ({spent:.0f} s the reference); determined readings "
        f"rounded in {rounded}; {len(skipped)} contradict themselves by rounding, left out: "
        f"{skipped[:10]}"
    )


if __name__ == "__main__":
    main()
