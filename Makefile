# Two commands do everything: `make book` and `make test`. The rest are their parts.
PYTHON ?= python3
VENV   := .venv
PY     := $(VENV)/bin/python
export OPENBLAS_NUM_THREADS := 1
export JUPYTER_PLATFORM_DIRS := 1
# Every kernel and test process would compile the library again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: book test checks lowest lab sweep execute lint style types clean setup

book: setup execute
	@$(PY) -m sphinx -c book -d build/doctrees -n -W --keep-going --quiet . _build/html
	@$(PY) -m bookkit check-html _build/html
	@echo "The book is built: open $(CURDIR)/_build/html/index.html"

# Types are looked over while tests run: one process would leave a core idle for a minute.
# PROCESSOR=farthest runs the notebooks again with the oldest kernels this machine can use.
PROCESSOR ?= own
test: setup style
	@$(MAKE) --no-print-directory --jobs=2 types checks

checks: setup
	@$(PY) -m pytest -q -n 2 --dist=loadscope --processor=$(PROCESSOR)

# The core with the lowest versions that pyproject.toml declares.
LOWEST := tests/base tests/models tests/filters/test_kalman.py tests/filters/test_forecasting.py
lowest:
	@test -d build/lowest || "$(PYTHON)" -m venv build/lowest
	@build/lowest/bin/python -m pip install --quiet --disable-pip-version-check -r lowest.txt
	@PYTHONPATH=.:tests build/lowest/bin/python -m pytest -q -c /dev/null --rootdir=. \
		--confcutdir=tests --import-mode=importlib $(LOWEST)

lab: setup
	@$(VENV)/bin/jupyter lab notebooks

sweep: setup
	@test -n "$(NB)" -a -n "$(GRID)" || { echo "usage: make sweep NB=notebooks/x.ipynb GRID=sweeps/x.yaml"; exit 2; }
	@$(PY) -m bookkit sweep $(NB) $(GRID) --out runs/$(basename $(notdir $(GRID)))

execute: setup
	@$(PY) -m bookkit execute

lint: style types

style: setup
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/ruff format --check .

types: setup
	@rm -rf build/programs && $(PY) -m bookkit programs build/programs
	@$(VENV)/bin/basedpyright --pythonpath $(PY)

clean:
	rm -rf $(VENV) _build build runs book/claims.md .pytest_cache .ruff_cache

setup: $(VENV)/.installed

$(VENV)/.installed: requirements.lock peers.lock pyproject.toml setup.sh
	@sh setup.sh "$(PYTHON)" "$(VENV)"
