# The package on ROS 2 Jazzy as docs/install.md installs it: docker build -t mems_ins_fusion .
# It has not been built by its authors, who had no Docker: .github/workflows/jazzy.yml builds it.
FROM ros:jazzy-ros-base

SHELL ["/bin/bash", "-c"]
RUN apt-get update && apt-get install -y --no-install-recommends python3-venv python3-pip && rm -rf /var/lib/apt/lists/*

WORKDIR /ws
COPY . src/mems_ins_fusion

# what rosdep knows comes from Ubuntu and ROS
RUN apt-get update && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src --rosdistro jazzy -y && rm -rf /var/lib/apt/lists/*
# what it does not know comes from PyPI, beside them
RUN python3 -m venv --system-site-packages .venv && touch .venv/COLCON_IGNORE \
    && .venv/bin/pip install 'numba>=0.59' 'numpy<2' 'rosbags>=0.11.1'

RUN . /opt/ros/jazzy/setup.bash && . .venv/bin/activate \
    && python -m colcon build --packages-select mems_ins_fusion
# compiled for the machine that builds the image; another one with other instructions compiles anew
ENV NUMBA_CACHE_DIR=/ws/cache
RUN . /opt/ros/jazzy/setup.bash && . .venv/bin/activate && . install/setup.bash \
    && ros2 run mems_ins_fusion compile

ENTRYPOINT ["/bin/bash", "-c", ". /opt/ros/jazzy/setup.bash && . .venv/bin/activate && . install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "run", "mems_ins_fusion", "fusion_node"]
