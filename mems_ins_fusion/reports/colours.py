"""The colours of all pages, the same for the same thing: the palette of Okabe and Ito, which colour-blind people can
distinguish."""
from __future__ import annotations

#: of the sensor error models
MODELS = {'random_walk': '#d55e00', 'gauss_markov': '#0072b2', 'autoregressive': '#009e73'}
MODEL_NAMES = {'random_walk': 'random walk', 'gauss_markov': 'Gauss-Markov', 'autoregressive': 'autoregressive'}
#: line styles and widths of them: later lines are thinner, so that lines on top of each other are all visible
DASHES = {'random_walk': '-', 'gauss_markov': '-', 'autoregressive': (0, (4, 3))}
WIDTHS = {'random_walk': 2.4, 'gauss_markov': 1.5, 'autoregressive': 1.1}
#: of the stages of a diagnosis, and of two results that are compared
BEFORE, FITTED, AFTER = '#d55e00', '#8c959f', '#0072b2'
FIRST, SECOND = '#d55e00', '#0072b2'
SMOOTHED = '#f0e442'
TRUTH, OUTAGE, FIX, WITHHELD, REFUSED = '#b8bec5', '#cc79a7', '#56b4e9', '#e69f00', '#000000'
