# make demo: simulate a city drive, replay it, print the position error of each sensor error model
# make test: run the tests with the newest versions of all that is needed
# make test-oldest: run those of the filter, the nodes and replay with the oldest (test/oldest.txt)
# make docs: the documentation as a site, docs/_build/index.html; fails where a link between pages is broken
# Each sets up what it needs in .venv or .venv-oldest, ROS 2 included. PYTHON=python3.12 chooses another Python.
PYTHON ?= python3
BIN := .venv/bin
OLDEST := .venv-oldest/bin
# one process for each core
PYTEST := -m pytest -q -n auto
PIP := -m pip install --quiet --disable-pip-version-check

.PHONY: demo test test-oldest docs

demo: .venv/ros
	$(BIN)/python -m mems_ins_fusion compile
	$(BIN)/python -m mems_ins_fusion simulate --output demo/drive --duration 600 --seed 1 --overwrite
	$(BIN)/python -m mems_ins_fusion replay_node --ros-args -p bag:=demo/drive -p output_dir:=demo/replay \
	    -p reference_topic:=/reference/fix -p overwrite:=true

# compiled ahead: else each process of the tests does it
test: .venv/ros,test
	$(BIN)/python -m mems_ins_fusion compile
	$(BIN)/python $(PYTEST) test

test-oldest: .venv-oldest/ros,test
	$(OLDEST)/python -m mems_ins_fusion compile
	$(OLDEST)/python $(PYTEST) $(filter-out test/test_node_killed.py, $(wildcard test/test_filter*.py test/test_navigation*.py test/test_fusion_node*.py \
	    test/test_node*.py test/test_replay*.py test/test_evaluation*.py test/test_compiled.py))

docs: .venv/docs
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build

# an empty file in the environment for each set of extras that is installed there
.venv/%: setup.py pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python $(PIP) --editable '.[$*]'
	touch '$@'

.venv-oldest/%: setup.py pyproject.toml test/oldest.txt
	test -x $(OLDEST)/python || $(PYTHON) -m venv .venv-oldest
	$(OLDEST)/python $(PIP) --editable '.[$*]' --constraint test/oldest.txt
	touch '$@'
