# make demo and make test each set up .venv on a fresh clone; a second call sets up nothing.
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip install --quiet --disable-pip-version-check
export MPLBACKEND := Agg
# Workers share the cores; BLAS threads of small matrices only wait for each other.
export OPENBLAS_NUM_THREADS := 1
# What one process has compiled serves the next.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo report test test-slow lint docs notebooks bench bench-quick gpu-check clean

demo: $(VENV)/.demo
	$(PY) -m experiments localisation
	$(PY) -m experiments plaza

report: $(VENV)/.demo
	$(PY) -m experiments report

test: $(VENV)/.test
	$(PY) -m pytest -n auto --dist loadfile

test-slow: $(VENV)/.test
	$(PY) -m pytest -n auto --dist load -m slow

lint: $(VENV)/.test
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

docs: $(VENV)/.docs
	$(PY) -m sphinx -W --keep-going --quiet --jobs 2 --doctree-dir build/doctrees docs build/docs
	@echo "build/docs/index.html"

notebooks: $(VENV)/.test
	$(PY) docs/building/notebooks.py build/notebooks

bench: $(VENV)/.bench
	$(PY) -m benchmarks --record
	$(PY) -m benchmarks.gains --record
	$(PY) -m benchmarks.first_call --record
	$(PY) -m benchmarks.page

bench-quick: $(VENV)/.bench
	$(PY) -m benchmarks --quick

gpu-check: $(VENV)/.test
	$(PY) -m benchmarks.gpu_check

clean:
	rm -rf $(VENV) results build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(PY):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "pgm needs Python 3.11 or newer; name one: make PYTHON=python3.12 $(MAKECMDGOALS)")'
	$(PYTHON) -m venv $(VENV)

# gtsam and rtb-data bring recordings, and gtsam is a library to be measured against; where one has no
# wheel everything else still works.
define install
	@$(PIP) --editable '.$(1)'
	@$(PIP) --editable '.[plaza]' || echo "gtsam cannot be installed for this Python: the plaza experiment will say so and stop"
	@$(PIP) --editable '.[maps]' || echo "rtb-data cannot be installed: no Killian Court recording, no floor plan"
	@touch $@
endef

$(VENV)/.demo: pyproject.toml | $(PY)
	$(call install,[experiments])

$(VENV)/.test: pyproject.toml | $(PY)
	$(call install,[test])

$(VENV)/.docs: pyproject.toml | $(PY)
	$(call install,[docs])

# The package particles says that it needs NumPy 1, and works with 2.
$(VENV)/.bench: pyproject.toml | $(PY)
	@$(PIP) --no-deps 'particles==0.4' || echo "particles cannot be installed: its rows are left out"
	$(call install,[bench])
