"""The measurements, one file each: innovation z, its derivative H, and its covariance R.

The compiled function `observe(mem, r, at, h, n, c, sample)` of a measurement fills its event (columns `Event`) with z =
predicted minus measured, and the rows of H, one for each component, and returns the number of components. It leaves the
optional states out of z: `update.update` subtracts H x. All work on the filter's flat memory `mem`: `r` is the position
of the state, `at` that of the event, `h` that of the first row of H (`n` floats each, zero on entry), `sample` that of
the IMU sample of that time. `c` is the rotation from b to n (9 elements). Body axes are forward-right-down.

Everything else about a measurement (samples, messages, parameters, optional states, events, simulation) is in the
`Measurement` class (base.py) of the same file, which registry.py lists.
"""
