"""Fusion of a low-cost inertial sensor with GNSS on land vehicles, and the tools to find out what its model lacks.

Frames: `n` local level, north-east-down; `b` vehicle body, forward-right-down; `s` sensor axes, as in the message. SI
units and radians inside; yaw is clockwise from north.

Words. Sample: what the IMU delivers at one time, specific force and angular rate; fix: a GNSS position; measurement:
whatever corrects a state, a fix as well; event: one of them as the kernel takes it, a row of numbers. State: navigation
solution, estimated errors x and their covariance P at one time, a row of the filter's memory. Error: estimate minus
truth. Innovation: predicted minus measured. Verdict: what the filter did with a measurement. Start: the first state;
alignment: the way to it. Standstill: the vehicle does not move. Outage: a time without fixes; coasting: the filter in
one. Replay: a recording through the filter, sample by sample as live. Effect: what real vehicles and sensors do and the
filter's model lacks; finding: one that the diagnosis proved. Counts begin with n_ (n_navigation, n_augmented).
"""

__version__ = '0.1.0'
