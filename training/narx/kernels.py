"""The compiled loops over time of the NARX: free run, its cost, and rows of its Jacobian.

All of them stand in one file, because numba's cache checks only the file of the function itself,
not those of the functions that it calls. Weights and regressors lie as in ``network``; ``x`` holds
the inputs' part of every regressor, (n, n_boxes * n_inputs).
"""
# mypy: disable-error-code="no-untyped-def"

import math

import numpy as np
from numba import njit

GROUP = 8  # tanh evaluated side by side
EXP_SERIES = tuple(1.0 / math.factorial(n) for n in range(14))
FAST = {"contract", "reassoc", "nsz"}  # sums in any order; NaN and infinity keep their meaning


@njit(fastmath={"contract", "nsz"}, error_model="numpy", inline="always")
def _tanh(x):  # pragma: no cover
    """Return tanh(x) within 1e-15, in operations that the compiler turns into vectors.

    Source: tanh|x| = (1 - e) / (1 + e) with e = exp(-2|x|) = 2^k exp(r), |r| <= ln(2) / 2, ln(2) in
    two parts, exp(r) by its series (Cody and Waite, Software manual for the elementary functions).
    """
    z = -2.0 * min(abs(x), 20.0)  # beyond 20 tanh is 1 in float64
    k = np.floor(z * 1.4426950408889634 + 0.5)
    r = (z - k * 0.6931471803691238) - k * 1.9082149292705877e-10
    series = EXP_SERIES[13]
    for n in range(12, -1, -1):
        series = series * r + EXP_SERIES[n]
    e = series * np.int64((np.int64(k) + 1023) << 52).view(np.float64)
    return np.copysign((1.0 - e) / (1.0 + e), x)


@njit(inline="always")
def _activation_rows(sizes):  # pragma: no cover
    """Return zeros (n_layers, widest), the width a multiple of the group."""
    widest = 0
    for size in sizes:
        widest = max(widest, size)
    return np.zeros((len(sizes), -(-widest // GROUP) * GROUP))


@njit(fastmath=FAST, error_model="numpy")
def _evaluate(weights, sizes, activations):  # pragma: no cover
    """Fill ``activations`` from row 0, the regressor, upward; return the linear output."""
    last = len(sizes) - 1
    at = 0
    for layer in range(1, last + 1):
        fan_in, fan_out = sizes[layer - 1], sizes[layer]
        bias = at + fan_in * fan_out
        below, here = activations[layer - 1], activations[layer]
        for i in range(fan_out):
            total = weights[bias + i]
            row = weights[at + i * fan_in : at + (i + 1) * fan_in]  # a view lets it vectorise
            for k in range(fan_in):
                total += row[k] * below[k]
            here[i] = total
        if layer < last:
            for first in range(0, fan_out, GROUP):
                group = here[first : first + GROUP]
                for i in range(GROUP):  # a fixed count, so that it becomes one vector
                    group[i] = _tanh(group[i])
        at = bias + fan_out
    output = activations[last, 0]
    if at < len(weights):  # the linear path
        path, regressor = weights[at:], activations[0]
        for k in range(len(path)):
            output += path[k] * regressor[k]
    return output


@njit
def _fill_regressor(x, t, history, regressor):  # pragma: no cover
    """Write the regressor of sample ``t``: ``x[t]``, then ``history`` (lags,), newest first."""
    n = x.shape[1]
    for k in range(n):
        regressor[k] = x[t, k]
    for lag in range(len(history)):
        regressor[n + lag] = history[lag]


@njit(inline="always")
def _begin(past, history):  # pragma: no cover
    """Copy ``history`` (lags,) in a loop; ``past[:] = history`` compiles for seconds."""
    for j in range(len(past)):
        past[j] = history[j]


@njit(inline="always")
def _remember(history, y):  # pragma: no cover
    """Put ``y`` in front of ``history`` (lags,)."""
    for j in range(len(history) - 1, 0, -1):
        history[j] = history[j - 1]
    history[0] = y


@njit(inline="always")
def _error(value, y, low, high):  # pragma: no cover
    """Return ``value - y``; a reading at an end of its range only says that the output is beyond.

    Source: Tobin, Estimation of relationships for limited dependent variables (1958): the reading
    is the output, censored.
    """
    if (y == high and value > high) or (y == low and value < low):
        return 0.0
    return value - y


@njit(nogil=True, cache=True)
def simulate(weights, sizes, x, lags, start, stop, history, low, high, out):  # pragma: no cover
    """Write the free run of every piece to ``out`` (n,)."""
    activations = _activation_rows(sizes)
    past = np.empty(lags)
    for i in range(len(start)):
        _begin(past, history[i])
        for t in range(start[i], stop[i]):
            _fill_regressor(x, t, past, activations[0])
            y = min(max(_evaluate(weights, sizes, activations), low), high)
            out[t] = y
            _remember(past, y)


@njit(nogil=True, cache=True)
def cost(weights, network, weight, run):  # pragma: no cover
    """Return the weighted sum of squared errors of every piece's free run (n_pieces,).

    network : sizes, x, y
    run : lags, low, high, start, stop, skip, history
    """
    sizes, x, y = network
    lags, low, high, start, stop, skip, history = run
    activations = _activation_rows(sizes)
    past = np.empty(lags)
    total = np.zeros(len(start))
    for i in range(len(start)):
        _begin(past, history[i])
        for t in range(start[i], stop[i]):
            _fill_regressor(x, t, past, activations[0])
            value = _evaluate(weights, sizes, activations)
            if t - start[i] >= skip[i]:
                total[i] += weight[t] * _error(value, y[t], low, high) ** 2
            _remember(past, min(max(value, low), high))
    return total


@njit(fastmath=FAST)
def _backpropagate(weights, sizes, activations, delta, row):  # pragma: no cover
    """Write df/dw to ``row``; leave df/dregressor in delta[0]."""
    last = len(sizes) - 1
    stop = 0
    for layer in range(1, last + 1):
        stop += (sizes[layer - 1] + 1) * sizes[layer]
    path = stop
    delta[last, 0] = 1.0
    for layer in range(last, 0, -1):
        fan_in, fan_out = sizes[layer - 1], sizes[layer]
        bias = stop - fan_out
        matrix = bias - fan_in * fan_out
        below, delta_below = activations[layer - 1], delta[layer - 1]
        delta_below[:fan_in] = 0.0
        for i in range(fan_out):
            d = delta[layer, i]
            row[bias + i] = d
            part = row[matrix + i * fan_in : matrix + (i + 1) * fan_in]
            weight = weights[matrix + i * fan_in : matrix + (i + 1) * fan_in]
            for k in range(fan_in):
                part[k] = d * below[k]
                delta_below[k] += d * weight[k]
        if layer > 1:
            for k in range(fan_in):
                delta_below[k] *= 1.0 - below[k] * below[k]
        stop = matrix
    for k in range(len(weights) - path):
        row[path + k] = activations[0, k]
        delta[0, k] += weights[path + k]


@njit(nogil=True, cache=True, fastmath=FAST)
def fill(weights, network, root_weight, run, kept):  # pragma: no cover
    """Fill rows until the buffers are full or the pieces end; return their number.

    network, run : as of ``cost``
    kept : cursor, past, ring, jacobian, error. The cursor is (piece, t, slot) to go on from, t < 0
        at the start of a piece; the ring, (lags + 1, n_weights), holds the derivatives of the last
        predictions, the newest in ``slot``
    """
    sizes, x, y = network
    lags, low, high, start, stop, skip, history = run
    cursor, past, ring, jacobian, error = kept
    activations = _activation_rows(sizes)
    delta = np.zeros_like(activations)
    gain = delta[0, sizes[0] - lags : sizes[0]]  # df/dy of every lag
    rows = 0
    piece, t, slot = cursor[0], cursor[1], cursor[2]
    while piece < len(start):
        if t < 0:
            t = start[piece]
            _begin(past, history[piece])
        while t < stop[piece]:
            if rows == len(error):
                cursor[0], cursor[1], cursor[2] = piece, t, slot
                return rows
            slot = (slot + 1) % (lags + 1)
            row = ring[slot]
            _fill_regressor(x, t, past, activations[0])
            value = _evaluate(weights, sizes, activations)
            _backpropagate(weights, sizes, activations, delta, row)
            for j in range(min(lags, t - start[piece])):
                old = ring[(slot - 1 - j) % (lags + 1)]
                for k in range(len(row)):
                    row[k] += gain[j] * old[k]
            if root_weight[t] > 0.0 and t - start[piece] >= skip[piece]:
                missed = _error(value, y[t], low, high)
                counts = root_weight[t] if missed != 0.0 else 0.0
                scored = jacobian[rows]
                for k in range(len(row)):
                    scored[k] = row[k] * counts
                error[rows] = missed * counts
                rows += 1
            clipped = min(max(value, low), high)
            if value != clipped:
                row[:] = 0.0
            _remember(past, clipped)
            t += 1
        piece += 1
        t = -1
    cursor[0], cursor[1], cursor[2] = piece, -1, slot
    return rows
