"""Which sensor a signal is of: the upstream one of the first bank, or another."""

import re
from typing import Final

from monitor.mapping.words import words_of

_DOWNSTREAM: Final = re.compile(
    r"downstream|post_?cat|nach_?kat|hinter|after_?cat|behind|rear|second|sekund|stromab|"
    r"\b(post|nk|hk|ds|nach|after|aft|tail|lsh|lsf|sec|binary|binaer|narrow\w*|nernst|switching)\b"
)
_UPSTREAM: Final = re.compile(
    r"upstream|pre_?cat|vor_?kat|stromauf|before_?cat|\b(pre|vk|us|vor|front|primary|lsu|b1s1)\b"
)
_NUMBERED: Final = re.compile(
    r"h?o2s?|lambda\w*|lam\w*|afr|uego|lsu|sensor|sonde|bank|trim|stft|wideband|wbo?|ego|frm?|"
    r"cylinder|cyl|b|s"
)
_BANK: Final = re.compile(r"\b(left|right|links|rechts|li|re|lh|rh|bank [a-z]|odd|even)\b")


def is_upstream(text: str) -> bool:
    """Return whether a text says that its sensor stands before the catalyst."""
    return _UPSTREAM.search(_plain(text)) is not None


def elsewhere(texts: tuple[str, ...]) -> str:
    """Return why a signal is not that of the upstream sensor of bank 1, "" if nothing says so."""
    for text in texts:
        plain = _plain(text)
        down = _DOWNSTREAM.search(plain)
        if down:
            return f"{short(text)} says {down[0]!r}: not the upstream sensor"
        bank = _BANK.search(plain)
        if bank:
            return f"{short(text)} says {bank[0]!r}: one of two banks, say which is bank 1"
        if re.search(r"\b(k|c)at\b|kataly|catalyst", plain) and not _UPSTREAM.search(plain):
            return f"{short(text)} names the catalyst: perhaps the downstream sensor"
    for text in texts[:2]:
        numbers = _sensor_numbers(text)
        words = words_of(text)
        if text is texts[0] and words[-1:] and words[-1].isdigit():
            numbers.append(int(words[-1]))
        other = [n for n in numbers if n not in (0, 1)]
        if other:
            return f"{text} has the number {other[0]}: perhaps bank 2 or the downstream sensor"
    return ""


def _plain(text: str) -> str:
    return " ".join(words_of(text))


def _sensor_numbers(text: str) -> list[int]:
    """Return the numbers of bank and sensor in a name: B1S2, O2S12, Lambda_2, Sonde 2."""
    found: list[int] = []
    words = words_of(text)
    for word, after in zip(words, (*words[1:], ""), strict=False):
        match = re.fullmatch(r"(?:h?o2s|b|s|bank|sensor|bk|sens|cyl|zyl)(\d+)", word)
        if match:
            found += [int(digit) for digit in match[1]]
        elif _NUMBERED.fullmatch(word) and after.isdigit():
            found += [int(digit) for digit in after.lstrip("0")] or [0]
    return found


def short(text: str) -> str:
    """Return a text on one line, of 60 characters at most."""
    plain = " ".join(text.split())
    return plain if len(plain) <= 60 else plain[:57] + "..."
