"""Every model that statsmodels' tests filter or smooth, module by module."""

import importlib
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import pgm

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # statsmodels' own
    pytest.importorskip("statsmodels", reason="statsmodels comes with the extra bench")
    from peers.judged import by_limit, by_reference, by_statsmodels, faults, made

    recorded = importlib.import_module("peers.recorded")
from peers.statsmodels_chain import statsmodels_chain

MODULES = (
    "smoothing", "exact_diffuse_filtering", "structural", "collapsed", "univariate", "concentrated",
    "simulation_smoothing", "varmax", "dynamic_factor", "cfa_simulation_smoothing", "chandrasekhar",
    "cfa_tvpvar", "models", "kalman", "exponential_smoothing", "var", "conserve_memory",
)  # fmt: skip
REACH = 5e4  # steps × states³ up to which 300 digits take seconds: of a longer record the start


def record(module, folder):
    command = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider"]
    command += ["-p", "peers.recorded", "--pyargs", f"statsmodels.tsa.statespace.tests.{module}"]
    paths = os.pathsep.join(str(path) for path in Path(__file__).parents[1:3])
    environment = os.environ | {"PEERS_RECORDS": str(folder), "PYTHONPATH": paths}
    subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=False)


def wrong(path):
    """What the chain of a recorded model has wrong; None if statsmodels has no answer to equal."""
    ssm, result = made(lambda: recorded.replayed(path))
    try:
        chain = statsmodels_chain(ssm)
        chain.filter()
    except NotImplementedError:
        return None  # diffuse along a plane
    except pgm.ModelError as error:  # initial covariances with rounding for variances
        return None if re.search("negative|infinite", str(error)) else repr(error)
    except pgm.NumericalError as error:
        return None if "contradicts" in str(error) else repr(error)
    settled = result.nobs_diffuse
    found = faults(chain, by_statsmodels(result), ssm.nobs, settled)
    if not found:
        return found
    within = int(REACH / ssm.k_states**3)
    if within < ssm.nobs:
        ssm, result = made(lambda: recorded.replayed(path, max(within, 8)))
        chain, settled = statsmodels_chain(ssm), result.nobs_diffuse
    due = by_limit(chain, ssm.nobs) if settled else by_reference(chain, ssm.nobs)
    return faults(chain, due, ssm.nobs, settled)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pgm.PrecisionWarning")  # what is told is compared too
@pytest.mark.parametrize("module", MODULES)
def test_models_of_statsmodels_own_tests(module, tmp_path):
    record(f"test_{module}", tmp_path)
    paths = sorted(tmp_path.glob("*.npz"))
    assert paths, f"statsmodels' test_{module} filtered nothing, or is not installed"
    found = {path.name: wrong(path) for path in paths}
    assert any(fault is not None for fault in found.values())
    assert not {name: fault for name, fault in found.items() if fault}
