# Two commands: `make demo` probes an object in simulation, `make test` runs the tests.
# `make test-all` runs also those that take long, `make quick` a minute's worth of them.
# The newest CPython that runs here.
PYTHON ?= $(shell for v in 14 13 12 11; do python3.$$v -c '' 2>/dev/null && echo python3.$$v && break; done)
VENV   ?= .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
SIM    := $(VENV)/.sim
# Python compiles what it imports, once; pip would compile every file of every package, uv does not.
FROM_PIP := install --quiet --disable-pip-version-check --only-binary=:all: --no-compile -c constraints.txt
UV       := $(shell command -v uv)
WITH_UV  := $(UV) pip install --quiet --python $(BIN)/python --only-binary=:all: -c constraints.txt
WITH_PIP := PYTHONWARNINGS=ignore $(BIN)/python -m pip $(FROM_PIP)
# Shell command that installs $(1). uv is faster, but ignores pip's settings, such as an index of packages.
INSTALL   = $(if $(UV),$(WITH_UV) $(1) || { echo "uv failed (it does not read pip's settings): installing with pip ..."; $(WITH_PIP) $(1); },$(WITH_PIP) $(1))
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all test-page quick lint docs env clean

# Only what it needs; what the tests need comes with them.
demo: $(SIM)
	@$(BIN)/palpate demo

test: $(READY)
	@$(BIN)/pytest

test-all: $(READY)
	@$(BIN)/pytest -m ""

# The page of the workbench in a real Chromium, which must be there.
test-page: $(READY)
	@{ $(call INSTALL,-e '.[bench]'); } && $(BIN)/pytest -m '' tests/palpate/workbench/test_page.py

# What another Python or machine could break: engines and drivers on emulated wires; `make demo` fits and diagnoses.
quick: $(READY)
	@$(BIN)/pytest tests/contract tests/sim_backend --ignore-glob='*/test_imperfections*.py' tests/test_import_directions.py

lint: $(READY)
	@$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy

# The site of docs/, in build/site; a link that leads nowhere fails.
docs: $(READY)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict && echo "open build/site/index.html"

env: $(READY)

# The interpreter is checked before anything is downloaded.
$(VENV)/bin/python:
	@command -v "$(PYTHON)" >/dev/null 2>&1 || { \
	  echo "palpate needs CPython 3.11 or newer ($(or $(PYTHON),python3.11) was not found)."; \
	  echo "Install it (Debian 12: apt install python3.11 python3.11-venv; elsewhere: pyenv install 3.11, or uv python install 3.11)"; \
	  echo "and name it if needed: make PYTHON=/path/to/python3.11 demo"; exit 2; }
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if v >= (3, 11) else "palpate needs CPython 3.11 or newer, this is %d.%d. Use: make PYTHON=python3.11" % v)'
	@$(PYTHON) -m venv --without-pip $(VENV)
# A new pip installs in two thirds of the time of the one that Python brings, which remains the fallback.
	@$(if $(UV),$(WITH_UV) pip 2>/dev/null ||) $(PYTHON) -m pip --python $@ $(FROM_PIP) pip 2>/dev/null || $@ -m ensurepip --default-pip >/dev/null || { \
	  rm -rf $(VENV); echo "This Python has neither pip nor ensurepip; on Debian and Ubuntu: apt install python3-venv"; exit 2; }

$(SIM): EXTRA := sim
$(READY): EXTRA := dev
$(SIM) $(READY): pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing palpate[$(EXTRA)] in $(VENV) (once, less than a minute) ..."
	@$(call INSTALL,-e '.[$(EXTRA)]') || { \
	  echo "palpate's packages could not be installed (see above). Nothing is compiled here: if a wheel is missing, this"; \
	  echo "platform is not supported (tested: Linux on x86-64); otherwise look at the network and run make again."; exit 2; }
	@$(BIN)/python -c 'import pinocchio' || { \
	  echo "A library of the system is missing (see above); on Debian and Ubuntu: apt install libgomp1"; exit 2; }
	@touch $(if $(filter dev,$(EXTRA)),$(SIM)) $@

clean:
	rm -rf $(VENV) $(VENV)-* build *.egg-info
