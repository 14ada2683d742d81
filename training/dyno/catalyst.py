"""Three-way catalyst and the switching sensor behind it, for the compiled mixture loop.

Oxygen is stored in ``CELLS`` cells in series. With x = 1 - phi (positive is lean) of the gas that
enters a cell, the cell stores 0.23 · air flow · x · rho g/s and the gas leaves it with
(1 - rho) · x. rho falls to zero where a cell is full (lean gas) or empty (rich gas), and release is
slower than filling. What a cell stores is limited by its room, so the balance holds exactly.

Sources:
- Brandt, Wang and Grizzle, Dynamic modeling of a three-way catalyst for SI engine exhaust emission
  control, IEEE Trans. Control Systems Technology 8 (2000): the storage equation with 0.23, rho of
  the sign of the mixture and the filling, capacity falling with age, switching sensor behind it;
- Auckenthaler, Modelling and control of three-way catalytic converters, ETH 16018 (2005): cells in
  series, slower reduction than oxidation of ceria, hydrogen that shifts the switching sensor;
- Peyton Jones, Roberts, Pan and Jackson, SAE 1999-01-0860: storage and release at unequal rates;
- Kumar, Makki and Filev, SAE 2014: capacity and activity that follow the brick's temperature;
- Furey and Monroe, SAE 811228, SAE 872163 and SAE 910844: sulphur on ceria and alumina hinders
  three-way activity in rich gas; rich operation takes it off, and above 700 degC it matters less;
- Fisher, Theis, Casarella and Mahan, SAE 931034: the role of ceria in the monitoring of catalysts.
"""

from typing import Final

import numba
import numpy as np

from monitor.base.types import FloatArray
from training.dyno.cycles import STEP_S
from training.dyno.downstream import Brick, Downstream

CELLS: Final = 5
SUBSTEPS: Final = 4  # of a 10 ms step: at full flow a cell of 6 mg fills within 2 ms
OXYGEN_IN_AIR: Final = 0.23  # mass fraction
LIGHT_OFF_DEGC: Final = 300.0
FULL_DEGC: Final = 550.0  # from here the whole capacity takes part
LAG_TO_RICH_S: Final = 0.05  # a switching sensor is quicker towards rich
LAG_TO_LEAN_S: Final = 0.11
TIP_LAG_S: Final = 20.0  # of the sensor's tip behind heater and gas
TIP_HEAT_DEGC: Final = 700.0  # the heater at full duty heats the tip by so much
TIP_GAS: Final = 0.7  # part of the brick's temperature that the gas gives the tip
TIP_AIM_DEGC: Final = 680.0  # the ECU heats to here
TIP_BAND_DEGC: Final = 60.0  # below the aim, within which the duty falls from full
TIP_WAKES_DEGC: Final = 350.0  # below it the electrolyte does not conduct
TIP_ACTIVE_DEGC: Final = 480.0
WIDE_NOISE: Final = 0.0005  # of a wide-range sensor, in x
TRIM_MOST: Final = 0.02  # authority of the outer trim, in phi
REFILL_PHI: Final = 0.03  # enrichment after a fuel cut, until the downstream sensor reads rich
REFILLED_V: Final = 0.55
REFILL_MOST_S: Final = 12.0
TRIM_AFTER_S: Final = 3.0  # after a fuel cut
SULPHUR_S: Final = 600.0  # rich gas of 700 degC takes sulphur away with this time constant
SULPHUR_DEGC: Final = 60.0  # hotter by so much, it goes e times as fast
SULPHUR_SLOWS: Final = 2.0  # release over a store that sulphur blocks
STEPS_WARM_DEGC: Final = 450.0  # active steps: brick, air flow and rest before they begin
STEPS_AIR_G_S: Final = (4.0, 45.0)
STEPS_AFTER_S: Final = 4.0
STEPS_HALVES: Final = 6  # half periods of one test; each ends when the sensor has switched
STEPS_MOST_S: Final = 7.0  # of a half period
STEPS_PAUSE_S: Final = 90.0  # between two tests
RING: Final = 512  # steps of 10 ms, the longest dead time


@numba.njit(cache=True)
def activity(degc: float) -> float:
    """Return how far the brick has lit off, 0 to 1."""
    return 1.0 / (1.0 + np.exp(-(degc - LIGHT_OFF_DEGC) / 22.0))


@numba.njit(cache=True)
def usable_g(capacity_g: float, degc: float) -> float:
    """Return the oxygen that a catalyst can hold at a temperature in g."""
    warm = min(max((degc - 200.0) / (FULL_DEGC - 200.0), 0.0), 1.0)
    return capacity_g * (0.25 + 0.75 * warm)


@numba.njit(cache=True)
def store(
    cells_g: FloatArray,
    x_in: float,
    air_g_s: float,
    step_s: float,
    usable: float,
    release_half: float,
    d: Downstream,
    lit: float,
) -> float:
    """Fill or empty the cells, (CELLS,) g each, for one step; return x of the gas behind them.

    release_half : part of a cell's filling at which rho of rich gas is 1/2
    """
    room = usable / len(cells_g)
    reach = lit * (1.0 - np.exp(-d.flow_g_s / air_g_s))
    x = x_in
    for j in range(len(cells_g)):
        inflow = OXYGEN_IN_AIR * air_g_s * x * step_s  # g, negative is a want of oxygen
        if x > 0.0:
            free = max(room - cells_g[j], 0.0)
            rho = reach * free / (free + d.fill_half * room)
            stored = min(rho * inflow, free)
        else:
            held = max(cells_g[j], 0.0)
            rho = reach * held / (held + release_half * room)
            stored = -min(-rho * inflow, held)
        cells_g[j] += stored
        if inflow != 0.0:
            x *= 1.0 - stored / inflow
    return x


@numba.njit(cache=True)
def _brick_degc(degc: float, x_in: float, x_out: float, air_g_s: float, cut: bool) -> float:
    """Return the brick's temperature one step later: gas, exotherm and loss to the road."""
    gas = 20.0 if cut else 60.0
    gas += 420.0 + 330.0 * air_g_s / (air_g_s + 15.0) if not cut else 180.0
    exotherm = 60.0 * activity(degc) if not cut else 0.0
    # CO over ceria gives at most some 1,700 K per unit of x; part of it leaves with the gas
    exotherm += 900.0 * abs(x_in - x_out) * activity(degc) if not cut else 0.0
    rate = 0.010 + 0.0035 * air_g_s  # 1/s, of a brick of 0.35 kg, 0.7 l of coated cordierite
    return degc + STEP_S * (rate * (gas + exotherm - degc) - 0.0008 * (degc - 20.0))


@numba.njit(cache=True)
def _sulphur(blocked: float, degc: float, x_in: float) -> float:
    """Return the part that sulphur blocks one step later: hot rich gas takes it away."""
    if x_in >= 0.0:
        return blocked
    rate = np.exp(min((degc - 700.0) / SULPHUR_DEGC, 3.0)) / SULPHUR_S
    return blocked * (1.0 - STEP_S * rate)


@numba.njit(cache=True)
def _richness(d: Downstream, x: float) -> float:
    """Return the richness that a switching sensor shows in the steady state, 0 to 1."""
    return 1.0 / (1.0 + np.exp(min(max(x / d.width, -40.0), 40.0)))


@numba.njit(cache=True)
def _heated(b: Brick, degc: float, power: float) -> tuple[float, float, float]:
    """Return the sensor's temperature, its heater's duty and how far it works, a step later.

    power : part of the heating power that is left
    """
    aim = TIP_GAS * degc + TIP_HEAT_DEGC * b.heater * power
    tip_degc = b.tip_degc + (aim - b.tip_degc) * STEP_S / TIP_LAG_S
    duty = min(max((TIP_AIM_DEGC - tip_degc) / TIP_BAND_DEGC, 0.05), 1.0)
    awake = (tip_degc - TIP_WAKES_DEGC) / (TIP_ACTIVE_DEGC - TIP_WAKES_DEGC)
    return tip_degc, duty, min(max(awake, 0.0), 1.0)


@numba.njit(cache=True)
def _active(
    b: Brick, volts: float, air_g_s: float, ready: bool, d: Downstream
) -> tuple[float, float, float]:
    """Return step, time and half periods of the ECU's active test one step later."""
    ready = ready and STEPS_AIR_G_S[0] < air_g_s < STEPS_AIR_G_S[1] and b.degc > STEPS_WARM_DEGC
    if d.steps == 0.0 or not ready:
        return 0.0, min(b.step_s, 0.0) + STEP_S * (b.step_s < 0.0), 0.0
    if b.step == 0.0:
        return (-1.0, 0.0, 0.0) if b.step_s >= STEPS_AFTER_S else (0.0, b.step_s + STEP_S, 0.0)
    has_switched = volts > REFILLED_V if b.step > 0.0 else volts < 0.3
    if not has_switched and b.step_s < STEPS_MOST_S:
        return b.step, b.step_s + STEP_S, b.halves
    if b.halves + 1.0 >= STEPS_HALVES:
        return 0.0, -STEPS_PAUSE_S, 0.0
    return -b.step, 0.0, b.halves + 1.0


@numba.njit(cache=True)
def step(
    b: Brick,
    cells_g: FloatArray,
    ring: FloatArray,
    k: int,
    phi_in: float,
    air_g_s: float,
    since_cut_s: float,
    closed: bool,
    noise: float,
    d: Downstream,
) -> Brick:
    """Return the state one step of 10 ms later; ``cells_g`` and ``ring`` change in place.

    ring : (RING,) the sensor's steady reading of the last steps, for its dead time
    since_cut_s : since the last fuel cut, 0 within one
    closed : whether the lambda controller is active; the outer trim follows it
    """
    t_s, air, cut = k * STEP_S, max(air_g_s, 0.5), since_cut_s <= 0.0
    x_in, lit = 1.0 - phi_in, activity(b.degc)
    usable = usable_g(d.capacity_g, b.degc) * (1.0 - b.sulphur)
    release_half = d.release_half * (1.0 + SULPHUR_SLOWS * b.sulphur)
    x_out = 0.0
    for _ in range(SUBSTEPS):
        part_s = STEP_S / SUBSTEPS
        x_out += store(cells_g, x_in, air, part_s, usable, release_half, d, lit) / SUBSTEPS
    degc = _brick_degc(b.degc, x_in, x_out, air, cut)
    pipe_s = d.pipe_l / (air * 2.4)  # exhaust of 570 °C: 2.4 l per g
    filled = lit * (2.0 * cells_g[-1] / max(usable / len(cells_g), 1e-9) - 1.0)
    leaked = x_out + d.equilibrium * filled + d.leak * np.exp(-(air - 3.0) / 8.0)
    x_pipe = b.x_pipe + (leaked - b.x_pipe) * (1.0 - np.exp(-STEP_S / pipe_s))
    faulty = t_s >= d.start_s
    # hydrogen, whose making sulphur hinders, lets the gas seem richer
    seen = x_pipe - d.hydrogen * (1.5 - 0.5 * activity(degc)) * (1.0 - b.sulphur)
    ring[k % RING] = -(seen + d.wide_offset) if d.wide > 0.0 else _richness(d, seen)
    now = ring[k % RING]
    if faulty and d.delay_to_rich_s + d.delay_to_lean_s > 0.0:
        late_rich = ring[(k - int(d.delay_to_rich_s / STEP_S)) % RING]
        late_lean = ring[(k - int(d.delay_to_lean_s / STEP_S)) % RING]
        if d.delay_to_lean_s == 0.0:
            now = min(now, late_rich)
        elif d.delay_to_rich_s == 0.0:
            now = max(now, late_lean)
        else:
            now = late_rich
    rising = now > b.reading
    tau_s = LAG_TO_RICH_S if rising else LAG_TO_LEAN_S
    if faulty:
        tau_s += d.tau_to_rich_s if rising else d.tau_to_lean_s
    reading = b.reading + (now - b.reading) * (1.0 - np.exp(-STEP_S / tau_s))
    # a cold sensor rests at 0.45 V behind its high resistance
    tip_degc, heater, heated = _heated(b, degc, d.heating if faulty else 1.0)
    hot_v = d.span_v * (1.0 - 0.00015 * max(degc - 400.0, 0.0))
    volts = d.low_v + hot_v * (_richness(d, -reading) if d.wide > 0.0 else reading)
    if faulty:
        volts = 0.45 + d.gain * (volts - 0.45)
    volts = 0.45 + heated * (volts - 0.45)
    if faulty and d.stuck_v > 0.0:
        volts = d.stuck_v
    volts += 0.004 * noise
    integral, trim = b.integral, b.trim
    if closed and since_cut_s > TRIM_AFTER_S and degc > LIGHT_OFF_DEGC and heated >= 1.0:
        error_v = min(max(0.62 - volts, -0.3), 0.3)  # below the aim the gas is too lean
        integral = min(max(integral + 0.0012 * error_v * STEP_S, -TRIM_MOST), TRIM_MOST)
        wanted = min(max(integral + 0.006 * error_v, -TRIM_MOST), TRIM_MOST)
        trim += (wanted - trim) * STEP_S / 0.4
    refilled = volts > REFILLED_V or since_cut_s > REFILL_MOST_S
    refill = 1.0 if cut else (0.0 if refilled else b.refill)
    is_ready = closed and since_cut_s > TRIM_AFTER_S and heated >= 1.0
    step, step_s, halves = _active(b, volts, air, is_ready, d)
    return Brick(
        degc=degc,
        x_out=x_out,
        x_pipe=x_pipe,
        reading=reading,
        volts=volts,
        trim=trim,
        integral=integral,
        heater=heater,
        tip_degc=tip_degc,
        step=step,
        step_s=step_s,
        halves=halves,
        sulphur=_sulphur(b.sulphur, degc, x_in),
        refill=refill,
    )
