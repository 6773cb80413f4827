"""Fusion of a low-cost inertial sensor with GNSS on land vehicles, and the tools to find out what its model lacks."""

__version__ = '0.1.0'
