# One command per purpose, the same on a laptop and in CI.

PYTHON  ?= python3
VENV    := .venv
DEMO    := .venv-demo
SPACE   := $(subst ,, )
PIP     := --quiet --disable-pip-version-check --no-compile
HEALTHY  = $(firstword $(sort $(wildcard replay_logs/healthy_*)))
FAULTY   = $(firstword $(sort $(wildcard replay_logs/delay_rich_to_lean_*)))

.PHONY: help demo vcan test whole check fast c-target properties examples docs pictures test-docs dist lint venv lock system bench matrix model calibration study replay_logs clean python

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z_-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(DEMO)/.installed ## replay a healthy and a faulty drive, write demo/report.html
	@test -n "$(HEALTHY)" -a -n "$(FAULTY)" || { echo "replay_logs/ has no healthy_* and delay_rich_to_lean_* log" >&2; exit 2; }
	@mkdir -p demo
	@echo "== $(HEALTHY)"
	@$(DEMO)/bin/o2mon replay $(HEALTHY) || { echo "make demo: the healthy drive was not judged healthy (exit $$?, wanted 0)" >&2; exit 1; }
	@echo "== $(FAULTY)"
	@$(DEMO)/bin/o2mon replay $(FAULTY); code=$$?; \
	  test $$code -eq 1 || { echo "make demo: the faulty drive was not judged faulty (exit $$code, wanted 1)" >&2; exit 1; }
	@$(DEMO)/bin/o2mon replay $(HEALTHY) $(FAULTY) --quiet --html demo/report.html; test $$? -eq 1
	@echo
	@echo "Healthy drive: no fault. Faulty drive: fault found."
	@echo "Open:     demo/report.html     both drives with pictures, in a browser"
	@echo "Try next: $(DEMO)/bin/o2mon inject $(HEALTHY) --out demo/weak.log --fault gain_low=0.5@60"
	@echo "          $(DEMO)/bin/o2mon replay demo/weak.log     a fault of your own"
	@echo "          docs/tour.md                               five minutes more; then your own car"

vcan: $(DEMO)/.installed ## play a drive with a fault into a virtual CAN bus, judge it live (a minute)
	@$(DEMO)/bin/python -c 'import msgpack' 2>/dev/null || \
	  $(DEMO)/bin/pip install --quiet --disable-pip-version-check -c constraints.txt '.[multicast]'
	@$(DEMO)/bin/python examples/virtual_bus.py

KINDS   := kernel browser trains thorough waits
$(if $(filter-out $(KINDS),$(WITHOUT)),$(error WITHOUT="$(WITHOUT)": some of $(KINDS) are wanted))

test: venv system ## every check: style, types, imports, all tests; WITHOUT="browser kernel" leaves tests out
	@$(MAKE) --no-print-directory -j 2 lint whole
	@test -z "$(WITHOUT)" || echo "== NOT TESTED, as WITHOUT=\"$(WITHOUT)\" says: $(WITHOUT)"

whole fast: export PYTHONDONTWRITEBYTECODE =

whole: venv build/.kernels
	$(VENV)/bin/python -m compileall -q monitor training dbc # once, not in each process that tests start
	$(VENV)/bin/python -m pytest -n 3 --dist loadscope --no-loadscope-reorder --durations 20 \
	  -m '$(if $(WITHOUT),not $(subst $(SPACE), and not ,$(strip $(WITHOUT))))' # one of three waits for a bus

build/.kernels: $(shell grep -rl numba training benchmarks monitor/base/faults.py --include=*.py) | venv
	$(VENV)/bin/python -m tests.helpers.models.kernels # while the types are checked, not in each worker
	@mkdir -p build && touch $@

check: venv ## style, types, imports and the fast tests
	@$(MAKE) --no-print-directory -j 2 lint fast

fast: venv
	$(VENV)/bin/python -m pytest -q -n 2 --dist loadscope --no-loadscope-reorder \
	  -m 'not kernel and not browser and not trains and not thorough and not waits'

c-target: venv ## the monitor as C on a Cortex-M4F: flash, RAM, stack, two drives in an emulator
	$(VENV)/bin/python -m pytest -q -s -rs tests/monitor/controller/test_on_the_core.py

properties: venv ## the property tests with ten times as many inputs, other ones in each run
	O2_INPUTS=2 $(VENV)/bin/python -m pytest -q -n 2 --dist loadscope --no-loadscope-reorder -m hypothesis

examples: venv ## run every example, also the long ones (ten minutes, on an idle machine)
	cd examples/firmware && CAN_INTERFACE=udp_multicast CAN_CHANNEL=239.74.163.2 ../../$(VENV)/bin/python -m pytest -q
	@for each in first_verdict listen_on_a_bus fleet_in_dask train_and_compare find_a_missing_effect; do \
	  echo "== examples/$$each.py"; $(VENV)/bin/python examples/$$each.py || exit 1; done

docs: venv ## the documentation as a site, build/site/index.html; needs no network, fails at a warning
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --strict
	@echo "open build/site/index.html, or with search: python3 -m http.server 8000 -d build/site"

pictures: venv ## take the pictures of the pages in the documentation anew (some minutes, needs chromium)
	PYTHONPATH=. $(VENV)/bin/python docs/site/pictures.py

test-docs: venv ## run every command of the documentation (some minutes)
	$(VENV)/bin/python -m tests.helpers.run_documentation

dist: venv ## wheel and sources in dist/, checked by twine, built twice with equal bytes
	sh share/build.sh $(VENV)/bin/python

lint: venv ## style, types, the direction of imports and the budget of the house
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	MYPYPATH=. $(VENV)/bin/mypy --strict examples/*.py examples/firmware/*.py # as a user's programs are
	$(VENV)/bin/lint-imports
	$(VENV)/bin/python -m tests.house

venv: $(VENV)/.installed ## the development environment in .venv

# All hashes but torch's: torch comes as a build for one machine, with a hash of its own.
lock: venv ## renew requirements-dev.lock from constraints.txt (needs uv)
	@mkdir -p build && head -2 requirements-dev.lock > build/lock.head
	grep -vE '^(#|torch==)' constraints.txt > build/pins.txt
	uv pip compile --quiet --no-deps --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
	  build/pins.txt -o build/pins.lock
	cat build/lock.head build/pins.lock > requirements-dev.lock

bench: venv ## benchmarks of speed on a small scale; fails at a missed target
	@code=0; for call in "replay_vs_plain_loop --seconds 600" streaming free_run \
	  "log_readers --seconds 20 --rounds 3" "fleet_log --seconds 60 --drives 32 --rounds 1" \
	  "fleet_scaling --counts 10 100"; do \
	  echo "== $$call"; $(VENV)/bin/python -m benchmarks $$call || code=1; done; exit $$code

# The shipped model: one healthy vehicle, every cycle, cold and hot weather, all simulated.
TRAINING := wltc_3b:1001 wltc_3b:1013 udds:1002 us06:1003 hwfet:1007 steady:1004 steady:1005 \
            micro_trips:1006 micro_trips:1014 micro_trips:1020 micro_trips:1036 micro_trips:1152 micro_trips:1198

matrix: venv ## drive the whole detection matrix, build/matrix/report.html (15 minutes)
	$(VENV)/bin/python -m benchmarks matrix --out build/matrix
	$(VENV)/bin/python -m benchmarks catalyst --out build/matrix/catalyst

model: venv ## train the shipped model anew (ten minutes)
	rm -rf build/training
	@for drive in $(TRAINING); do \
	  $(VENV)/bin/o2train simulate --out build/training --format parquet \
	    --cycle $${drive%%:*} --seed $${drive##*:} || exit 1; done
	$(VENV)/bin/o2train fit build/training/*.parquet --out monitor/model/shipped.onnx \
	  --lags 5 --hidden 8 8 --budget 10 --report build/fit.html
	$(MAKE) calibration

# Its limits: twenty other vehicles with fuels from E0 to E10, and sensors at the limit severities.
LIMIT_FAULTS := slow_rich_to_lean=0.5 slow_lean_to_rich=0.5 slow_symmetric=0.5 delay_rich_to_lean=0.4 \
                delay_lean_to_rich=0.4 delay_symmetric=0.4 transient=0.5 gain_low=0.6 \
                biased_lean=0.05 biased_rich=0.05

calibration: venv ## set the limits of the shipped model anew (two minutes)
	rm -rf build/calibration
	@set -e; n=0; for fault in $$(yes healthy | head -20) $(LIMIT_FAULTS) $(LIMIT_FAULTS); do \
	  case $$fault in healthy) own=; folder=healthy;; *) own="--fault $$fault"; folder=faulty;; esac; \
	  $(VENV)/bin/o2train simulate --out build/calibration/$$folder --format parquet $$own \
	    --vehicle $$((3000 + n % 20)) --seed $$((3000000 + n)) --effect ethanol=$$((n * 3 % 11)); \
	  n=$$((n + 1)); done
	$(VENV)/bin/o2train calibrate --model monitor/model/shipped.onnx \
	  --healthy build/calibration/healthy/*.parquet --faulty build/calibration/faulty/*.parquet \
	  --report build/calibration.html --json build/calibration.json

# The paper's study on simulated drives: those of the shipped model train and choose, others judge.
STUDY_TEST   := wltc_3b:2001 udds:2002 us06:2003
STUDY_FAULTS := slow_symmetric slow_rich_to_lean delay_rich_to_lean delay_symmetric gain_low biased_lean

study: venv ## the paper's whole study on simulated drives, build/study/report.html
	rm -rf build/study_drives
	@for drive in $(TRAINING:%=train/%) $(STUDY_TEST:%=test/%); do \
	  name=$${drive##*/}; \
	  $(VENV)/bin/o2train simulate --out build/study_drives/$${drive%%/*} --format parquet \
	    --cycle $${name%%:*} --seed $${name##*:} || exit 1; done
	@for fault in $(STUDY_FAULTS); do \
	  $(VENV)/bin/o2train simulate --out build/study_drives/faulty --format parquet \
	    --cycle wltc_3b --seed 2004 --fault $$fault || exit 1; done
	$(VENV)/bin/o2train study build/study_drives/train/*.parquet --out build/study \
	  --test build/study_drives/test/*.parquet --faulty build/study_drives/faulty/*.parquet \
	  --steady build/study_drives/train/steady_*.parquet

replay_logs: venv ## simulate the drives of replay_logs and their expected events anew
	$(VENV)/bin/python replay_logs/make.py

clean: ## remove environments, caches and everything built
	rm -rf $(VENV) $(DEMO) .venv-dist demo build dist *.egg-info
	rm -rf .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Everything with its hash but torch, see requirements-dev.lock; torch and this package follow.
# pip would compile one file after the other, compileall takes all cores; files of other Pythons,
# which some packages hold, fail there.
$(VENV)/.installed: pyproject.toml constraints.txt requirements-dev.lock | python
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install $(PIP) --require-hashes --no-deps -r requirements-dev.lock
	$(VENV)/bin/pip install $(PIP) -c constraints.txt -e '.[dev]'
	@$(VENV)/bin/python -m compileall -qq -j 0 $(VENV)/lib || true
	@touch $@

# Not editable: the demo runs what a user installs, and nothing of training's libraries.
$(DEMO)/.installed: pyproject.toml constraints.txt $(shell find monitor dbc share training/dyno/cycles -type f -not -name '*.pyc') | python
	$(PYTHON) -m venv $(DEMO)
	$(DEMO)/bin/pip install --quiet --disable-pip-version-check -c constraints.txt .
	@touch $@

python:
	@command -v $(PYTHON) >/dev/null || { echo "there is no $(PYTHON); Debian: apt-get install python3 python3-venv" >&2; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "o2-monitor needs Python 3.11 or newer; say which with make PYTHON=python3.12" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' || \
	  { echo "$(PYTHON) cannot make environments; apt-get install python3-venv" >&2; exit 2; }

# The tests on a CAN bus need a kernel with vcan, or User-Mode Linux as one. Without either they
# are skipped, or fail if O2_REQUIRE_VCAN=1. Those of the live page need Debian's chromium, and fail
# without it if O2_REQUIRE_BROWSER=1.
system:
	@case " $(WITHOUT) " in *" kernel "*) ;; *) sh tests/vcan/install.sh ;; esac
	@case " $(WITHOUT) " in *" browser "*) ;; *) sh tests/helpers/install_browser.sh ;; esac
