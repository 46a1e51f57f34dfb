# `make demo` and `make test` set themselves up: python3 and nothing else is needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
# The tests start the program some hundred times: a shell that forbids Python to keep compiled modules would double their time.
export PYTHONDONTWRITEBYTECODE :=
# numba tries many types for each call, and would colour the text of an error for each that does not fit.
export NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING := 1
# Its processes share the cores: threads of linear algebra beside them would wait for each other.
PYTEST_ENVIRONMENT := QT_QPA_PLATFORM=offscreen OPENBLAS_NUM_THREADS=1
PYTEST := $(PYTEST_ENVIRONMENT) $(BIN)/pytest

.PHONY: demo test test-long test-lowest desktop docs words golden tables proof clean

demo: $(READY)
	$(BIN)/goniotwin demo

test: $(READY)
	@QT_QPA_PLATFORM=offscreen $(BIN)/python -c "import PySide6.QtWidgets" 2>/dev/null || { \
	  echo "The tests of the window need Qt's system libraries:"; \
	  $(BIN)/python -c "from goniotwin.app.cli.work.doctor import QT_LIBRARIES; print(QT_LIBRARIES)"; exit 1; }
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .
	@# The types take a minute of one core: at low priority, in what the tests leave.
	@echo "mypy and lint-imports run beside the tests; first the kernels are compiled, on both cores"; \
	{ nice -n 15 $(BIN)/mypy && PYTHONPATH=$(VENV)/links $(BIN)/lint-imports; } >$(VENV)/types.log 2>&1 & checks=$$!; \
	$(BIN)/python -m tests.kernels forward >$(VENV)/kernels.log 2>&1 & kernels=$$!; \
	trap 'kill $$checks $$kernels 2>/dev/null' EXIT; trap 'exit 130' INT TERM; \
	$(BIN)/python -m tests.kernels fast || exit 1; \
	wait $$kernels || { cat $(VENV)/kernels.log; exit 1; }; \
	$(PYTEST) -n 3 -m "not long"; tests=$$?; \
	wait $$checks; types=$$?; cat $(VENV)/types.log; \
	test $$tests -eq 0 && test $$types -eq 0

# The slow tests of the package check it with twine, and a clone with Pyright.
RELEASE := $(VENV)/release
$(RELEASE): $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[release]'
	@touch $(RELEASE)

# The slow proofs, in full; run before a change of what they prove is called done.
test-long: $(RELEASE)
	$(PYTEST) -n 3 -m "long or hypothesis" --hypothesis-profile=long

# The lowest versions that pyproject.toml allows, in an environment of their own, with the tests that read and write files.
LOWEST := $(VENV)/lowest
LOWEST_TESTS := tests/app/formats tests/app/data tests/app/test_command_line.py tests/app/test_keys.py tests/app/test_tables.py

test-lowest: $(READY)
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check uv
	$(LOWEST)/bin/uv pip compile --quiet --python $(LOWEST)/bin/python --resolution lowest-direct --extra xarray --extra dask \
	  --output-file $(LOWEST)/lowest.txt pyproject.toml
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --constraints $(LOWEST)/lowest.txt --editable '.[dev]'
	$(PYTEST_ENVIRONMENT) $(LOWEST)/bin/python -m pytest -n 2 --dist worksteal -m "not long" $(LOWEST_TESTS)

desktop: $(READY)
	$(BIN)/goniotwin

# The site, in build/site/index.html; needs no network.
docs: $(READY)
	$(BIN)/sphinx-build -q -W --keep-going -b html docs build/site

# Words and length of sentences of every page; forbids nothing.
words: $(READY)
	@$(BIN)/python -m tests.docs.words

# The golden files, after an intended change of values: the summary that is printed belongs into the commit.
golden: $(READY)
	$(PYTEST_ENVIRONMENT) $(BIN)/python -m tests.golden.make $(NAMES)

# The list of inputs in docs/physics/inputs.md, after a declaration in app/rig/inputs.py.
tables: $(READY)
	$(BIN)/python -m tests.input_list
	$(BIN)/python -m tests.arrival_list

# The proofs and their tables in docs/physics/uncertainty-proofs.md, from results in the folder proofs; after Ctrl-C the same command continues.
# Many hours with WIRES=yes RIGS=200.
RIGS := 10
STRUCTURES := 40
WIRES :=
PROOFS := lobes diffuse spectral transmitted anisotropic
WITHOUT = $(if $(WIRES),,--without-wires)
RESULTS = proofs/$(if $(WIRES),wires,direct)

proof: $(READY)
	@for each in $(PROOFS); do \
	  $(BIN)/goniotwin prove examples/proof/$$each.toml --rig examples/proof/rig.toml --rigs $(RIGS) $(WITHOUT) --out $(RESULTS)/$$each \
	    >/dev/null || exit 1; \
	done
	@$(BIN)/goniotwin prove --structures $(STRUCTURES) --rigs $(RIGS) $(WITHOUT) --out $(RESULTS)/structures
	$(BIN)/python -m tests.proof_tables $(foreach each,$(PROOFS) structures,$(RESULTS)/$(each))

$(READY): pyproject.toml constraints.txt $(wildcard package/*.py)
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11))" || { \
	  echo "goniotwin needs Python 3.11 or newer; name one: make PYTHON=python3.12 ..."; exit 1; }
	@$(PYTHON) -c "import ensurepip, venv" 2>/dev/null || { \
	  echo "Python's venv is missing. On Debian and Ubuntu: sudo apt-get install -y python3-venv"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@# The tools that read sources find them under their import name here.
	mkdir -p $(VENV)/links/goniotwin
	cd $(VENV)/links/goniotwin && ln -sfn $(foreach part,app drivers examples mocks protocols twin,../../../$(part)) . && ln -sf ../../../package/*.py ../../../package/py.typed .
	@touch $(READY)

clean:
	rm -rf $(VENV) demo build/site
