"""The guide to evidence: its program runs, and says what is so."""

import re
from pathlib import Path

import numpy as np
import pytest

import pgm

GUIDE = (Path(__file__).parents[3] / "docs" / "evidence.md").read_text(encoding="utf-8")


def test_the_guides_program_runs(capsys):
    space = {}
    for block in re.findall(r"^```python\n(.*?)^```", GUIDE, flags=re.MULTILINE | re.DOTALL):
        exec(compile(block, "evidence.md", "exec"), space)
    printed = capsys.readouterr().out
    right, total = (float(re.search(rf"{t} (\S+)", printed)[1]) for t in ("rain", "diary"))
    assert right > 0.85
    graph, days, evidence = space["graph"], space["days"], space["evidence"]
    lawn, sprinkler = space["lawn"], space["sprinkler"]
    assert (evidence[lawn] == -1).sum() == 500
    alone = [
        pgm.infer(
            graph,
            {sprinkler: int(days[sprinkler][k])} | ({lawn: int(days[lawn][k])} if k % 10 else {}),
        ).log_evidence
        for k in range(0, 5000, 499)
    ]
    batch = pgm.infer(graph, evidence).log_evidence
    np.testing.assert_allclose(batch[::499], alone, atol=1e-12)
    assert batch.sum() == pytest.approx(total)
    assert printed.rstrip().endswith("(5000, 2)")
