# make demo: simulate a city drive, replay it, print the position error of each sensor error model
# make test: run the tests
# Each sets up what it needs in .venv, ROS 2 included.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test

demo: .venv/ros
	$(BIN)/python -m mems_ins_fusion simulate --output demo/drive --duration 600 --seed 1 --overwrite
	$(BIN)/python -m mems_ins_fusion replay_node --ros-args -p bag:=demo/drive -p output_dir:=demo/replay \
	    -p reference_topic:=/reference/fix -p overwrite:=true

test: .venv/ros,test
	$(BIN)/python -m pytest -q test

# an empty file in .venv for each set of extras that is installed there
.venv/%: setup.py pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[$*]'
	touch '$@'
