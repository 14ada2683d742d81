"""The chain with its sensitivities, compiled: one pass gives the reading and all derivatives.

Forward sensitivities of the grey-box chain (``training.greybox.chain``) with a wall film before
it: the states' derivatives run through the same recursions as the states. Two things differ from
the chain: the delayed mixture is read by a cubic (Catmull and Rom, 1974) instead of a straight
line, so that the derivative over the dead time is continuous, and the sensor lags alike in both
directions.

A quantity's derivative over its own constants stands in its slopes; over its field's knots it
follows from the shares of the four knots around each sample.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from monitor.base.types import FloatArray, IntArray
from training.greybox.chain import AIR_LEAST_MG, STOICHIOMETRIC

EPSILON = 1e-5


@njit(cache=True)
def _hold(time: float) -> tuple[float, float]:  # pragma: no cover
    """Return the weights of the state and of the newest input in a lag of ``time`` samples."""
    keep = np.exp(-1.0 / time)
    return keep, 1.0 - time * (1.0 - keep)


class Columns(NamedTuple):
    """First column of each quantity's constants and of each field's knots."""

    fuel: int
    air: int
    share: int
    time: int
    delay: int
    heat: int
    mixing: int
    lag: int
    span: int
    gain_field: int
    share_field: int
    time_field: int
    delay_field: int
    lag_field: int
    size: int  # of the parameter vector; 0 asks for no derivatives


class Valve(NamedTuple):
    """Fuel, wall film and air; values (n,), slopes (n, m) over the quantity's constants.

    The slopes of the film's time are those of its logarithm. The first constant of share and time
    is the level of the law, which the field moves too.
    """

    fuel: FloatArray  # mg per stroke
    fuel_slopes: FloatArray
    air: FloatArray  # mg per stroke
    air_slopes: FloatArray
    share: FloatArray
    share_slopes: FloatArray
    time: FloatArray  # samples
    time_slopes: FloatArray
    gain: FloatArray
    strokes: FloatArray  # per sample period


class Way(NamedTuple):
    """From valve to sensor; values (n,) in samples, slopes (n, m).

    The last slope of the delay is over the logarithm of the pipe's volume, as its field. The
    slopes of the lag are over its logarithm; one field scales mixing and lag.
    """

    delay: FloatArray
    delay_slopes: FloatArray
    mixing: FloatArray
    mixing_slopes: FloatArray  # of its logarithm; the last one is its field's, too
    mixing_by_heat: FloatArray  # (n, 1), the same over the gas's heat
    lag: FloatArray
    lag_slopes: FloatArray
    span: float


@njit(cache=True)
def valve(  # noqa: PLR0912  calls would cost more than the loop
    v: Valve, c: Columns, knots: IntArray, shares: FloatArray
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    """Return phi at the valve (n,) and its derivatives (n, size)."""
    fuel, share, time, gain, strokes = v.fuel, v.share, v.time, v.gain, v.strokes
    size = c.size
    n = len(fuel)
    phi, slopes = np.empty(n), np.zeros((n, size))
    film = share[0] * fuel[0] * strokes[0] * time[0]
    onto = share[0] * fuel[0] * strokes[0]
    d_film, d_onto, d_now = np.zeros(size), np.zeros(size), np.zeros(size)
    for k in range(n):
        x, f, rate, t = share[k], fuel[k], strokes[k], time[k]
        keep, newest = _hold(t)
        last = 1.0 - keep - newest
        now = x * f * rate
        keep_up, newest_up = _hold(t * (1.0 + EPSILON))
        up = keep_up * film + t * (1.0 + EPSILON) * (
            newest_up * now + (1.0 - keep_up - newest_up) * onto
        )
        before = film
        film = keep * before + t * (newest * now + last * onto)
        by_time = film if k == 0 else (up - film) / EPSILON  # over the time's logarithm
        onto = now
        a = max(v.air[k], AIR_LEAST_MG)
        factor = gain[k] * STOICHIOMETRIC / a
        evaporated = film / (t * rate)
        phi[k] = factor * ((1.0 - x) * f + evaporated)
        if size == 0:
            continue
        d_now[:] = 0.0
        for j in range(v.fuel_slopes.shape[1]):
            d_now[c.fuel + j] = x * rate * v.fuel_slopes[k, j]
        for j in range(v.share_slopes.shape[1]):
            d_now[c.share + j] = f * rate * v.share_slopes[k, j]
        per_odds = v.share_slopes[k, 0]  # the first constant is the field's unit
        per_time = v.time_slopes[k, 0]
        for j in range(4):
            d_now[c.share_field + knots[k, j]] += f * rate * per_odds * shares[k, j]
        for p in range(size):
            if k == 0:  # the film begins settled
                d_film[p] = t * d_now[p]
            else:
                d_film[p] = keep * d_film[p] + t * (newest * d_now[p] + last * d_onto[p])
            d_onto[p] = d_now[p]
        for j in range(v.time_slopes.shape[1]):
            d_film[c.time + j] += by_time * v.time_slopes[k, j]
        for j in range(4):
            d_film[c.time_field + knots[k, j]] += by_time * per_time * shares[k, j]
        for p in range(size):
            slopes[k, p] = factor * d_film[p] / (t * rate)
        for j in range(v.fuel_slopes.shape[1]):
            slopes[k, c.fuel + j] += factor * (1.0 - x) * v.fuel_slopes[k, j]
        for j in range(v.share_slopes.shape[1]):
            slopes[k, c.share + j] -= factor * f * v.share_slopes[k, j]
        for j in range(v.time_slopes.shape[1]):
            slopes[k, c.time + j] -= factor * evaporated * v.time_slopes[k, j]
        for j in range(4):
            at = knots[k, j]
            slopes[k, c.share_field + at] -= factor * f * per_odds * shares[k, j]
            slopes[k, c.time_field + at] -= factor * evaporated * per_time * shares[k, j]
            slopes[k, c.gain_field + at] += phi[k] * shares[k, j]
        for j in range(v.air_slopes.shape[1]):
            slopes[k, c.air + j] -= phi[k] / a * v.air_slopes[k, j]
    return phi, slopes


@njit(cache=True)
def sensor(  # noqa: PLR0912, PLR0915  calls would cost more than the loop
    phi: FloatArray,
    phi_slopes: FloatArray,
    way: Way,
    c: Columns,
    knots: IntArray,
    shares: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    """Return the reading (n,) and its derivatives (n, size)."""
    delay, mixing, lag, span = way.delay, way.mixing, way.lag, way.span
    n, size = phi_slopes.shape
    reading, slopes = np.empty(n), np.zeros((n, size))
    mixed, late_last = phi[0], phi[0]
    read, pumped_last = 1.0 + span * (phi[0] - 1.0), 1.0 + span * (phi[0] - 1.0)
    d_late, d_late_last = np.zeros(size), np.zeros(size)
    d_mixed, d_pumped, d_pumped_last, d_read = (
        np.zeros(size),
        np.zeros(size),
        np.zeros(size),
        np.zeros(size),
    )
    m, mixers = way.delay_slopes.shape[1], way.mixing_slopes.shape[1]
    for k in range(n):
        at = min(max(k - delay[k], 0.0), k * 1.0)
        i = min(int(at), n - 2)
        s = at - i
        i0, i1, i2, i3 = max(i - 1, 0), i, min(i + 1, k), min(i + 2, k)
        w0 = ((2.0 - s) * s - 1.0) * s / 2.0
        w1 = ((3.0 * s - 5.0) * s * s + 2.0) / 2.0
        w2 = ((4.0 - 3.0 * s) * s + 1.0) * s / 2.0
        w3 = (s - 1.0) * s * s / 2.0
        late = w0 * phi[i0] + w1 * phi[i1] + w2 * phi[i2] + w3 * phi[i3]

        keep, newest = _hold(mixing[k])
        keep_up, newest_up = _hold(mixing[k] * (1.0 + EPSILON))
        last = 1.0 - keep - newest
        up = keep_up * mixed + newest_up * late + (1.0 - keep_up - newest_up) * late_last
        mixed = keep * mixed + newest * late + last * late_last
        by_mixing = (up - mixed) / EPSILON
        late_last = late

        pumped = 1.0 + span * (mixed - 1.0)
        held, fresh = _hold(lag[k])
        held_up, fresh_up = _hold(lag[k] * (1.0 + EPSILON))
        old = 1.0 - held - fresh
        up = held_up * read + fresh_up * pumped + (1.0 - held_up - fresh_up) * pumped_last
        read = held * read + fresh * pumped + old * pumped_last
        by_lag = (up - read) / EPSILON
        pumped_last = pumped
        reading[k] = read
        if size == 0:
            continue

        v0 = (4.0 * s - 3.0 * s * s - 1.0) / 2.0
        v1 = (9.0 * s * s - 10.0 * s) / 2.0
        v2 = (8.0 * s - 9.0 * s * s + 1.0) / 2.0
        v3 = (3.0 * s * s - 2.0 * s) / 2.0
        slope = v0 * phi[i0] + v1 * phi[i1] + v2 * phi[i2] + v3 * phi[i3]
        for p in range(size):
            d_late[p] = (
                w0 * phi_slopes[i0, p]
                + w1 * phi_slopes[i1, p]
                + w2 * phi_slopes[i2, p]
                + w3 * phi_slopes[i3, p]
            )
        for j in range(m):
            d_late[c.delay + j] -= slope * way.delay_slopes[k, j]
        for j in range(4):
            pipe = way.delay_slopes[k, m - 1] * shares[k, j]
            d_late[c.delay_field + knots[k, j]] -= slope * pipe
        for p in range(size):
            if k == 0:  # the chain begins settled
                d_mixed[p] = d_late_last[p] = d_late[p]
                d_read[p] = d_pumped_last[p] = span * d_late[p]
            d_mixed[p] = keep * d_mixed[p] + newest * d_late[p] + last * d_late_last[p]
            d_late_last[p] = d_late[p]
        for j in range(mixers):
            d_mixed[c.mixing + j] += by_mixing * way.mixing_slopes[k, j]
        d_mixed[c.heat] += by_mixing * way.mixing_by_heat[k, 0]
        for j in range(4):
            volume = way.mixing_slopes[k, mixers - 1] * shares[k, j]
            d_mixed[c.lag_field + knots[k, j]] += by_mixing * volume
        for p in range(size):
            d_pumped[p] = span * d_mixed[p]
        d_pumped[c.span] += mixed - 1.0
        if k == 0:
            d_read[c.span] += mixed - 1.0
            d_pumped_last[c.span] += mixed - 1.0
        for p in range(size):
            d_read[p] = held * d_read[p] + fresh * d_pumped[p] + old * d_pumped_last[p]
            d_pumped_last[p] = d_pumped[p]
        for j in range(way.lag_slopes.shape[1]):
            d_read[c.lag + j] += by_lag * way.lag_slopes[k, j]
        for j in range(4):
            d_read[c.lag_field + knots[k, j]] += by_lag * shares[k, j]
        for p in range(size):
            slopes[k, p] = d_read[p]
    return reading, slopes
