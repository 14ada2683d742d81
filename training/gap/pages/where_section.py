"""The part of the gap report that says where: words, tables and pictures of the findings."""

import html

from training.gap.pages.where_figures import (
    band_figure,
    curve_figure,
    excerpt_figure,
    label,
    map_figure,
    regime_figure,
    time_figure,
)
from training.gap.where.bands import Bands
from training.gap.where.findings import Findings
from training.gap.where.over_time import Change
from training.gap.where.regimes import Regime
from training.pages.page import paragraph, picture, table

SHOWN = 8  # regimes in the picture and table
SHOWN_CHANGES = 6


def section(found: Findings) -> str:
    """Return the HTML of the findings, to stand in a report."""
    return "\n".join(
        [
            _summary(found),
            "<h2>Where it shows best</h2>",
            picture(excerpt_figure(found.excerpt), "Measured and predicted phi; grey: not scored"),
            "<h2>Regimes</h2>",
            _regimes(found),
            "<h2>Operating range</h2>",
            _map(found),
            "<h2>Frequency</h2>",
            _bands(found.bands),
            "<h2>Over time</h2>",
            _changes(found.changes),
        ]
    )


def p_text(p: float) -> str:
    """Return a p-value as a reader wants it."""
    return "below 0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def _summary(found: Findings) -> str:
    over = found.excess
    against = "the healthy recordings" if over.relative else "the noise"
    rms, reference = over.mean_square**0.5, over.reference**0.5
    parts = [
        paragraph(
            f"{found.samples} scored samples. The residual is {rms:.4f} RMS in phi, "
            f"{reference:.4f} in {against}. {_excess_words(found)}"
        ),
        paragraph(found.floor.sentence),
    ]
    if found.significant:
        items = "".join(f"<li>{html.escape(s)}</li>" for s in found.significant)
        parts.append(f"<ul>{items}</ul>")
    else:
        parts.append(paragraph("Nothing found is beyond chance."))
    parts += [paragraph(note, "note") for note in found.notes]
    parts.append(
        paragraph(
            "Shares are of the excess squared error, with 90 % bounds from a bootstrap over blocks "
            "of 30 s. They overlap between drivers that move together, bands too, and do not "
            "add up to one. "
            "What is named is beyond chance at 2 % for regimes, at 1 % for every other kind.",
            "note",
        )
    )
    return "".join(parts)


def _excess_words(found: Findings) -> str:
    over = found.excess
    if over.low > 0.0:
        return f"{over.value / over.mean_square:.0%} of its square is excess."
    return (
        "That is not beyond chance, so shares below are of all of the squared error above white "
        "noise."
    )


def _regimes(found: Findings) -> str:
    shown = found.regimes[:SHOWN]
    rows = [
        (r.words, r.point, _share(r), p_text(r.p_value), f"{r.wins:.0%}")
        for r in (found.offset, *shown)
    ]
    head = ("driver", "enters", "share of the excess (90 %)", "p", "beats the next")
    words = (
        "A smooth function of one driver, fitted to some blocks of time and scored on others. "
        "Timing: edges come early or late. Sensitivity: the sensor reads too much or too little. "
        f"Of {len(found.regimes)} combinations of driver and point these explain most, on top of "
        "the constant offset in the first row; p is corrected for having tried all of them. The "
        "last column says in how many draws of blocks a row explains more than the next."
    )
    parts = [table(rows, head), paragraph(words, "note")]
    clear = [r for r in shown if r.significant]
    if clear:
        parts.insert(0, picture(regime_figure(clear), "What each driver explains"))
        curves = [r for r in clear if r.curve is not None][:3]
        if curves:
            parts.append(picture(curve_figure(curves), "Dependence with its 90 % band"))
    return "".join(parts)


def _share(r: Regime) -> str:
    return str(r.share) if r.significant else "–"


def _map(found: Findings) -> str:
    if found.map is None:
        return paragraph("No signal of speed or load moves.")
    return picture(map_figure(found.map), "Grey: hardly driven")


def _bands(found: Bands | None) -> str:
    if found is None:
        return paragraph("Unbroken stretches are too short for spectra.")
    rows = [
        (
            f"{b.low_hz:.2g} to {b.high_hz:.2g} Hz",
            str(b.share),
            p_text(b.p_level),
            label(b.coherent_with) if b.coherent else "none",
            f"{b.coherence:.2f}",
            p_text(b.p_coherence),
        )
        for b in found.bands
    ]
    head = ("band", "of the excess (90 %)", "p, more than healthy", "moves with", "coherence", "p")
    return picture(
        band_figure(found),
        "Left: spectrum of the residual. Right: coherence; red dots beyond chance",
    ) + table(rows, head)


def _changes(changes: tuple[Change, ...]) -> str:
    if not changes:
        return paragraph("The recordings are too short to look for an onset.")
    shown = changes[:SHOWN_CHANGES]
    rows = [
        (
            f"{c.recording}, {c.quantity}",
            c.kind if c.significant else "none",
            f"{c.t_s:.0f}",
            f"{c.before:+.4f}",
            f"{c.after:+.4f}",
            p_text(c.p_value),
            p_text(c.p_beyond_regime),
        )
        for c in shown
    ]
    head = ("recording", "change", "at s", "before", "after", "p", "p beyond the best driver")
    words = (
        "An onset within a drive is what a fault looks like. A change counts if it is beyond "
        "chance, larger than any on healthy drives, and not what the best driver explains."
    )
    figure = picture(time_figure(shown), "Residual in blocks of 10 s; red: beyond chance")
    return figure + table(rows, head) + paragraph(words, "note")
