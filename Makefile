# make demo: simulate a city drive, replay it, print the position error of each sensor error model
# make test: run the tests with the newest versions of all that is needed
# make test-oldest: run those that may fail with the oldest versions (test/oldest.txt)
# make docs: the documentation as a site, docs/_build/index.html; fails where a link between pages is broken
# Each sets up what it needs in .venv or .venv-oldest, ROS 2 included. PYTHON=python3.12 chooses another Python.
PYTHON ?= python3
BIN := .venv/bin
OLDEST := .venv-oldest/bin
# one process more than cores, as tests of nodes wait for clocks and for each other for a fifth of the time; what the
# tests of a file share is made once, in one of them. By name, since the last files are short ones: else one core would
# wait for the other
WORKERS := $(shell expr $$(nproc 2>/dev/null || getconf _NPROCESSORS_ONLN) + 1)
PYTEST := -m pytest -q -n $(WORKERS) --dist loadfile --no-loadscope-reorder
# s, after which a test counts as one that hangs: it fails, its file goes on in a new process. The longest one takes
# some 30 s with both cores for it
PYTEST += -o faulthandler_timeout=400 -o faulthandler_exit_on_timeout=true
# tests start Python some hundred times: without bytecode each of them compiles the package's files, which takes 0.4 s
unexport PYTHONDONTWRITEBYTECODE
PIP := -m pip install --quiet --disable-pip-version-check
# as a path: else Python takes this repository for the package where it starts in the folder that contains it
PIP += --config-settings editable_mode=compat

.PHONY: demo test test-oldest compiled compiled-oldest docs

demo: .venv/ros
	$(BIN)/python -m mems_ins_fusion compile
	$(BIN)/python -m mems_ins_fusion simulate --output demo/drive --duration 600 --seed 1 --aiding --overwrite
	$(BIN)/python -m mems_ins_fusion replay_node --ros-args -p bag:=demo/drive -p output_dir:=demo/replay \
	    -p reference_topic:=/reference/fix -p overwrite:=true

test: compiled
	$(BIN)/python $(PYTEST) test

# what numba, NumPy, SciPy, matplotlib and rosbags may do otherwise: compile each function, give the filter's numbers
# (test_numbers.py, to 1e-9, with all that it decides), read and write messages and arrays, calculate and draw for each
# tool. What the filter makes of other drives follows from the numbers; what the system does with files and signals, and
# ROS 2 with topics, clocks and logs, is the same
OLDEST_TESTS := $(wildcard $(patsubst %, test/test_%.py, compiled numbers examples replay evaluation_outages \
    filter_columns filter_live filter_prediction filter_smoothing filter_update navigation* fusion_node \
    fusion_node_parameters node_output node_state_file characterize))
test-oldest: compiled-oldest
	$(OLDEST)/python $(PYTEST) -k 'not killed and not interrupted and not overwritten and not silent' $(OLDEST_TESTS)

# ahead: else each process of the tests does it
compiled: .venv/ros,test
	$(BIN)/python -m mems_ins_fusion compile

compiled-oldest: .venv-oldest/ros
	$(OLDEST)/python -m mems_ins_fusion compile

docs: .venv/docs
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build

# an empty file in the environment for each set of extras that is installed there. Bytecode is made where it is needed:
# that of all packages takes a minute of a core, of which most is never read
.venv/%: setup.py pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python $(PIP) --no-compile --editable '.[$*]'
	touch '$@'

.venv-oldest/%: setup.py pyproject.toml test/oldest.txt
	test -x $(OLDEST)/python || $(PYTHON) -m venv .venv-oldest
	$(OLDEST)/python $(PIP) --no-compile --editable '.[$*]' pytest pytest-xdist hypothesis --constraint test/oldest.txt
	touch '$@'
