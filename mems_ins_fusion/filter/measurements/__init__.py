"""What can be measured: a file each, with the innovation z, its derivative H, and its covariance R.

`observe` of a measurement fills a record (columns `Event`) with z = predicted minus measured, and the rows of H, one
for each component. What the optional states explain of z stands in H alone: `update.update` takes H x out. All of
them work on the flat memory of the filter: `r` is the position of the state, `at` that of the record, `h` that of the
first row of H (each n long, zero on entry). Body axes are forward-right-down.

All else that is particular to a measurement - its samples, messages, parameters, optional states, records, how it is
simulated - stands in its `Measurement` (base.py) of the same file, which `registry` lists.
"""
