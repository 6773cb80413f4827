"""GPS time: weeks since 6 January 1980, seconds of the week, and its difference to UTC."""
from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np

from mems_ins_fusion.samples import SECOND

EPOCH = 315_964_800  # s: 6 January 1980
WEEK = 604_800  # s
#: GPS minus UTC, s, from this date on (IERS Bulletin C)
_LEAP_SECONDS = ((datetime(1999, 1, 1), 13), (datetime(2006, 1, 1), 14), (datetime(2009, 1, 1), 15),
                 (datetime(2012, 7, 1), 16), (datetime(2015, 7, 1), 17), (datetime(2017, 1, 1), 18))


def leap_seconds(stamp: int) -> int:
    """GPS minus UTC, s, at `stamp`, ns since 1970."""
    when = datetime(1970, 1, 1) + timedelta(seconds=stamp // SECOND)
    return next((seconds for since, seconds in reversed(_LEAP_SECONDS) if when >= since), 0)


def utc_of_week(week: np.ndarray, into: np.ndarray) -> np.ndarray:
    """Stamps, (n,) ns since 1970, UTC. week: (n,) whole weeks. into: (n,) ns since the begin of the week."""
    stamp = (EPOCH + np.asarray(week, np.int64) * WEEK) * SECOND + into
    return stamp - leap_seconds(int(stamp[0])) * SECOND if len(stamp) else stamp
