# TurtleBag. `make demo` and `make test` need nothing set up before: both build .venv themselves.
# Every stage leaves a manifest.json last, and make compares those: what is up to date is not redone.

# What to do; give any of these on the command line.
WORLD ?= turtlebot3_world
ROBOT ?= $(if $(filter turtlebot3_house,$(WORLD)),waffle_pi,burger)
SEED ?= 1
TELEOP ?= tour
TASK ?= patrol
GOAL ?=
START ?=
PYTHON ?= python3
DATA ?= data

# Where it goes: OUT names the output folder of the one stage that is asked for.
NAME := $(WORLD)-$(ROBOT)-$(TELEOP)-$(SEED)
RECORD_DIR = $(if $(filter record,$(MAKECMDGOALS)),$(or $(OUT),$(DATA)/records/$(NAME)),$(DATA)/records/$(NAME))
MAP_DIR = $(if $(filter map,$(MAKECMDGOALS)),$(or $(OUT),$(DATA)/maps/$(NAME)),$(DATA)/maps/$(NAME))
RUN_DIR = $(if $(filter navigate,$(MAKECMDGOALS)),$(or $(OUT),$(DATA)/runs/$(NAME)-$(TASK)),$(DATA)/runs/$(NAME)-$(TASK))
REPORT_DIR = $(if $(filter report,$(MAKECMDGOALS)),$(or $(OUT),$(DATA)/reports/$(NAME)-$(TASK)),$(DATA)/reports/$(NAME)-$(TASK))
# Where it comes from: an own bag or log (BAG=) or an own map yaml (MAP=) takes the place of the stage before.
BAG_INPUT = $(or $(BAG),$(RECORD_DIR))
MAP_INPUT = $(or $(MAP),$(MAP_DIR)/map.yaml)
NEEDS_MAP = $(filter patrol goal,$(TASK))
# The tutorial's names for the maps of its two worlds.
TUTORIAL_turtlebot3_world := map_world
TUTORIAL_turtlebot3_house := map_house

PY := .venv/bin/python
TURTLEBAG := .venv/bin/turtlebag
READY := .venv/.ready
sources = $(shell find $(1) -name '*.py' -o -name '*.yaml' -o -name '*.j2')
DEMO := $(addsuffix /turtlebot3_world-burger-tour-$(SEED),records maps) runs/turtlebot3_world-burger-tour-$(SEED)-patrol \
  $(addsuffix /turtlebot3_house-waffle_pi-tour-$(SEED),records maps) $(addprefix runs/turtlebot3_house-waffle_pi-tour-$(SEED)-,goal avoid)
REPORT_ON = $(if $(BAG),,$(RECORD_DIR)) $(if $(NEEDS_MAP),$(if $(MAP),,$(MAP_DIR))) $(RUN_DIR)

.DEFAULT_GOAL := help
.PHONY: help setup doctor demo demo-world demo-house pictures studio studio-pictures notebooks record map navigate report verify dist docs lint test browser clean \
  bench results bench-speed bench-commands bench-sim bench-slam bench-slam-all bench-coverage bench-localise bench-plan bench-navigate bench-twin bench-studio bench-bags bench-install platforms bench-sweep bench-front-ends bench-peers peers mutants coverage pytest study-advice study-ablation study-breaks board
.DELETE_ON_ERROR:
# Outputs of a task that failed are whole and keep their manifest, but so old that make does the stage again.
.PRECIOUS: $(RECORD_DIR)/manifest.json $(MAP_DIR)/manifest.json $(RUN_DIR)/manifest.json
OR_AGAIN = || { code=$$?; [ ! -f $@ ] || touch -t 197001020000 $@; exit $$code; }
RECORD = $(TURTLEBAG) record --force --world $(WORLD) --robot $(ROBOT) --teleop $(TELEOP) --seed $(SEED) --out $(@D)
MAPPING = $(TURTLEBAG) map $(BAG_INPUT) --force --out $(@D) $(if $(BAG),,--truth $(RECORD_DIR)/truth)
NAVIGATE = $(TURTLEBAG) navigate --force --world $(WORLD) --robot $(ROBOT) --task $(TASK) --seed $(SEED) --out $(@D) \
  $(if $(NEEDS_MAP),--map $(MAP_INPUT) --initial-pose start) $(if $(GOAL),--goal=$(GOAL)) $(if $(START),--start=$(START))

help: ## list the targets
	@grep -hE '^[a-z][a-z _-]*:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 20

setup: $(READY) ## make the virtual environment (every other target does this when needed)

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	  || { echo "make: needs Python 3.11 or newer with venv (on Debian: apt install python3-venv); or make PYTHON=/path/to/python3 ..." >&2; exit 2; }
	@$(PYTHON) -I pipeline/setup/install.py $(@D)
	@touch $@

doctor: $(READY) ## check the installation: one line for each missing part
	$(TURTLEBAG) doctor

demo: $(READY) ## record, map and navigate in the arena and the house, then report
	$(MAKE) --no-print-directory --jobs=2 demo-world demo-house
	$(TURTLEBAG) report --force --out $(DATA)/reports/demo $(addprefix $(DATA)/,$(DEMO))

demo-world:
	$(MAKE) --no-print-directory record map navigate WORLD=turtlebot3_world TASK=patrol

demo-house:
	$(MAKE) --no-print-directory record map navigate WORLD=turtlebot3_house TASK=goal GOAL=5.5,-4.5,-1.5708
	$(MAKE) --no-print-directory navigate WORLD=turtlebot3_house TASK=avoid START=1,4,0

studio: $(READY) ## open a simulated robot in the browser   (WORLD ROBOT SEED MAP OUT)
	$(TURTLEBAG) studio --world $(WORLD) --robot $(ROBOT) --seed $(SEED) $(if $(MAP),--map $(MAP)) $(if $(OUT),--out $(OUT))

record: $(RECORD_DIR)/manifest.json ## drive a robot in a world, write a bag   (WORLD ROBOT TELEOP SEED OUT)
map: $(MAP_DIR)/manifest.json $(if $(TUTORIAL_$(WORLD)),$(DATA)/maps/$(TUTORIAL_$(WORLD)).yaml) ## build a map   (BAG OUT, or as record)
navigate: $(RUN_DIR)/manifest.json ## drive a task in closed loop   (TASK GOAL START MAP OUT, or as record)
report: $(REPORT_DIR)/manifest.json ## make the report page of a run   (OUT, or as navigate)

$(RECORD_DIR)/manifest.json: $(call sources,sim datasets reports/metrics) pipeline/stages/record.py | $(READY)
	@$(info $(RECORD))$(RECORD) $(OR_AGAIN)

$(MAP_DIR)/manifest.json: $(or $(BAG),$(RECORD_DIR)/manifest.json) $(call sources,pipeline/slam pipeline/slam3d datasets reports/metrics) $(wildcard pipeline/stages/map*.py) pipeline/stages/settings.py | $(READY)
	@$(info $(strip $(MAPPING)))$(MAPPING) $(OR_AGAIN)

$(DATA)/maps/$(TUTORIAL_$(WORLD)).yaml: $(MAP_DIR)/manifest.json
	cp $(MAP_DIR)/map.pgm $(@:.yaml=.pgm)
	sed 's/^image: map.pgm/image: $(notdir $(@:.yaml=.pgm))/' $(MAP_DIR)/map.yaml > $@

$(RUN_DIR)/manifest.json: $(if $(NEEDS_MAP),$(or $(MAP),$(MAP_DIR)/manifest.json)) $(call sources,sim datasets planners pipeline) | $(READY)
	@$(info $(strip $(NAVIGATE)))$(NAVIGATE) $(OR_AGAIN)

$(REPORT_DIR)/manifest.json: $(RUN_DIR)/manifest.json $(call sources,reports datasets) pipeline/stages/report.py | $(READY)
	$(TURTLEBAG) report --force --out $(@D) $(REPORT_ON)

# Everything the demo leaves, but for the manifests: those alone may tell one run from another.
override AGAIN := data/verify/demo
DEMO_AGAIN = rm -rf $(AGAIN) && $(MAKE) --no-print-directory demo DATA=$(AGAIN)
DEMO_HASHES = cd $(AGAIN) && find . -type f ! -name manifest.json -print0 | LC_ALL=C sort -z | xargs -0 sha256sum

verify: $(READY) ## run the demo twice in a folder of its own, compare every file, then verify its report
	mkdir -p data/verify
	$(DEMO_AGAIN)
	$(DEMO_HASHES) > ../first.sha256
	$(DEMO_AGAIN)
	$(DEMO_HASHES) > ../second.sha256
	diff data/verify/first.sha256 data/verify/second.sha256
	@echo "the same bytes twice: $$(wc -l < data/verify/first.sha256) files"
	$(TURTLEBAG) verify $(AGAIN)/reports/demo

pictures: demo ## the animations of the README and the figure of docs/how-it-maps.md, from the demo
	cp data/reports/demo/figures/turtlebot3-world-map-animation.gif docs/images/mapping.gif
	cp data/reports/demo/figures/turtlebot3-world-patrol-animation.gif docs/images/patrol.gif
	$(PY) .ci/site/mapping_figure.py $(addsuffix /turtlebot3_house-waffle_pi-tour-$(SEED),data/records data/maps) docs/images/how-it-maps.svg

studio-pictures: $(READY) ## the pictures of the studio in README and docs, taken with the browser
	$(PY) .ci/site/studio_pictures.py docs/images

notebooks: $(READY) ## run the notebooks and keep what they show   (needs `.venv/bin/pip install -e '.[notebooks]'`)
	$(PY) .ci/site/notebooks.py docs/notebooks
	$(PY) .ci/site/notebooks.py docs/course

bench: bench-speed bench-commands bench-sim bench-slam bench-localise bench-plan bench-navigate bench-twin bench-studio bench-bags bench-sweep ## all benchmarks: tables printed, and written below data/benchmarks
results: $(READY) ## the tables of docs/results.md, each row over at least ten seeds (TURTLEBAG_DATA=folder of the public logs)
	$(PY) -m benchmarks.results
bench-speed: $(READY) ## simulation and navigation: simulated seconds per second, AMCL's milliseconds, two cores (TURTLEBAG_DATA for BARN)
	$(PY) -m benchmarks.speed
bench-commands: $(READY) ## whole commands: mapping, the demo with report and verify, until the first words   (TURTLEBAG_DATA for Intel, ACES)
	$(PY) -m benchmarks.commands
bench-sim: $(READY) ## simulated seconds per second, by world and robot
	$(PY) -m benchmarks.sim
bench-slam: $(READY) ## maps, in less than 20 minutes: a sample of bench-slam-all
	$(PY) -m benchmarks.slam_campaign --quick
bench-slam-all: $(READY) ## maps: public logs (TURTLEBAG_DATA=folder of them), drives, disturbances; resumes if stopped
	$(PY) -m benchmarks.slam_campaign
bench-coverage: $(READY) ## whether uncertainty and verdicts are true: maps and localisations against the truth; resumes
	$(PY) -m benchmarks.coverage
	$(PY) -m benchmarks.p_bad
	$(PY) .ci/site/reliability_figure.py data/benchmarks/coverage docs/images/reliability.svg
bench-localise: $(READY) ## localisation: accuracy, speed, global, kidnapped
	$(PY) -m benchmarks.localise
bench-twin: $(READY) ## what identify finds of robots with hidden parameters: coverage of the intervals
	$(PY) -m benchmarks.twin
bench-plan: $(READY) ## planners: time, length, clearance, success
	$(PY) -m benchmarks.plan
bench-navigate: $(READY) ## campaigns of runs: patrol, goals, avoidance, BARN
	$(PY) -m benchmarks.navigate
bench-studio: $(READY) ## the studio: how late its frames are, bytes, speed with and without a viewer   (MINUTES of patrol for its memory)
	$(PY) -m benchmarks.studio $(if $(MINUTES),--minutes $(MINUTES))
bench-install: $(READY) ## the wheel and all it needs from the index, beside `datasets`, and the chain   (FOR=python3.12)
	TURTLEBAG_INSTALL_FOR=$(or $(FOR),$(PYTHON)) $(PY) -m pytest tests/test_wheel.py -k index
platforms: $(READY) ## ask the index which of the packages have wheels for Linux on aarch64 and for macOS
	TURTLEBAG_PLATFORMS=1 $(PY) -m pytest -s tests/cli/test_platform_wheels.py
bench-bags: $(READY) ## bags cut and flipped, inputs of all kinds broken, and every command killed
	TURTLEBAG_DAMAGES=500 TURTLEBAG_KILLS=10 TURTLEBAG_TRIES=100 $(PY) -m pytest tests/datasets/test_bag_damage.py tests/cli/test_fuzz.py tests/stages/test_kills.py
bench-front-ends: $(READY) ## all logs x all front ends x all seeds, a campaign that resumes (TURTLEBAG_DATA=folder of the public logs)
	cd $${TURTLEBAG_DATA:?names no folder of public logs} && $(CURDIR)/$(TURTLEBAG) sweep $(CURDIR)/benchmarks/front_ends.yaml --out $(CURDIR)/data/benchmarks/front_ends
bench-sweep: $(READY) ## campaigns: overhead of a case, second core, a question to a million rows
	$(PY) -m benchmarks.sweep

mutants: $(READY) ## mutation tests: small mistakes in the code, and how many a test notices   (SEED, N mutants)
	.venv/bin/pip install --quiet 'cosmic-ray>=8.4,<9'
	$(PY) -m tests.mutants $(SEED) $(or $(N),20)

# Kernels are measured where they run as plain Python: in the quick tests that call them, compared with a reference.
KERNEL_TESTS := $(wildcard tests/*/test_*_kernels.py) $(addprefix tests/,$(addsuffix .py, \
  datasets/test_deskew localisation/test_localisation_fields localisation/test_localisation_parts \
  localisation/test_localisation_surfaces localisation/test_localisation_walls planners/test_costmap \
  planners/test_footprint_motions planners/test_obstacle_layer planners/test_plan_footprint planners/test_plan_lattice \
  reports/test_seen_area sim/test_sim_lidar sim/test_sim_lidar3d slam/test_slam_lines slam/test_slam_matching \
  slam/test_slam_ranges slam3d/test_slam3d_parts))
COVERAGE = OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(PY) -m coverage run -m pytest
coverage: $(READY) ## lines and branches that the tests reach, by file, also in data/coverage/table.txt
	rm -rf data/coverage && mkdir -p data/coverage
	-$(COVERAGE) -n 3 --dist loadfile --no-loadscope-reorder
	-NUMBA_DISABLE_JIT=1 $(COVERAGE) -n 3 --dist loadfile -m "not slow" $(KERNEL_TESTS)
	$(PY) -m coverage combine --quiet
	$(PY) -m coverage report > data/coverage/table.txt
	cat data/coverage/table.txt

study-advice study-ablation study-breaks: study-%: $(READY) ## the studies: mapping advice, ablation with ground truth, faults
	$(TURTLEBAG) sweep $* --out data/studies/$*

# Other people's libraries, in an environment of their own.
PEERS := $(CURDIR)/data/peers/bin
$(PEERS)/.ready: benchmarks/peers/pyproject.toml benchmarks/peers/peers.py
	$(PYTHON) -m venv data/peers
	$(PEERS)/pip install --quiet ./benchmarks/peers
	rm -rf benchmarks/peers/build benchmarks/peers/*.egg-info
	@touch $@
peers: $(PEERS)/.ready ## install KISS-ICP, small_gicp, yag-slam and IR-SIM as programs, for the board and bench-peers
bench-peers: $(READY) peers ## ours beside other people's libraries: accuracy, CPU, memory, start-up; resumes if stopped
	PATH="$(CURDIR)/.venv/bin:$(PEERS):$$PATH" sh benchmarks/peers/bench.sh

board: $(READY) ## the board: standard inputs, our systems and (after make peers) others; resumes if stopped   (INPUTS='arena-*')
	PATH="$(PEERS):$$PATH" $(TURTLEBAG) board $(if $(INPUTS),--inputs '$(INPUTS)') --out $(DATA)/board

dist: $(READY) ## build the sdist, and the wheel from it, into dist/
	$(PY) -m build --no-isolation

docs: $(READY) ## make the documentation site, data/site/index.html, without the network
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs --quiet build --strict
	@echo data/site/index.html

lint: $(READY) ## ruff and mypy
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

test: $(READY) ## lint, and pytest beside it
	@$(MAKE) --no-print-directory --jobs=2 lint pytest

pytest: $(READY)
	@# Three workers, because some tests wait more than they compute; each file's tests run on one, so that what
	@# they share is made once; and bytecode is kept, or each of the many processes would compile all sources.
	@# Each has one thread, as there are more workers than cores.
	OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(PY) -m pytest -n 3 --dist loadfile --no-loadscope-reorder

browser: ## find Chromium for the browser test, or install it (Debian)
	@command -v chromium chromium-browser google-chrome || { apt-get update -qq && apt-get install -y -qq chromium; }

clean: ## remove everything made here, the virtual environment too
	rm -rf data .venv build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
