"""Results as JUnit XML, which GitLab, Jenkins and other CI servers show as tests."""

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from monitor.base.files.outputs import write_bytes

_NO_XML: Final = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class JunitCase:
    """A drive or scenario that passed, failed, was skipped or could not be tried."""

    name: str
    text: str  # what was printed about it
    said: str = ""  # one sentence: the failure, the error, why it was skipped; "" if it passed
    code: str = ""  # of a failure
    is_error: bool = False

    @property
    def outcome(self) -> str:
        """Return the name of the element that holds the outcome, "" of one that passed."""
        if self.is_error:
            return "error"
        return ("failure" if self.code else "skipped") if self.said else ""


@dataclass(slots=True)
class JunitRun:
    """The cases of a command so far, and the name of the one that is being tried."""

    name: str
    cases: list[JunitCase] = field(default_factory=list)


@contextmanager
def junit_file(path: Path | None, suite: str) -> Iterator[JunitRun]:
    """Give a run whose cases are written at its end, with the error that ends it.

    path : None for no file; suite : as in ``write_junit``
    """
    run = JunitRun(suite)
    try:
        yield run
    except BaseException as error:  # an interrupt, too: a run that is cut short has not passed
        said = str(error) or type(error).__name__
        run.cases.append(JunitCase(run.name, "", said, is_error=True))
        raise
    finally:
        if path and run.cases:
            write_junit(path, suite, run.cases)


def write_junit(path: Path, suite: str, cases: Sequence[JunitCase]) -> None:
    """Write the cases as one suite; raises UsageError if the file cannot be written.

    suite : with a point, such as ``o2mon.replay``
    The file has no clock and no times, so the same drives give the same bytes.
    """
    root = ElementTree.Element("testsuites", _counts(suite, cases))
    within = ElementTree.SubElement(root, "testsuite", _counts(suite, cases))
    for case in cases:
        facts = {"classname": suite, "name": _clean(case.name)}
        element = ElementTree.SubElement(within, "testcase", facts)
        if case.outcome:
            told = {"message": _clean(case.said)} | ({"type": case.code} if case.code else {})
            ElementTree.SubElement(element, case.outcome, told).text = _clean(case.text)
        else:
            ElementTree.SubElement(element, "system-out").text = _clean(case.text)
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, "utf-8", xml_declaration=True) + b"\n")


def _counts(suite: str, cases: Iterable[JunitCase]) -> dict[str, str]:
    outcomes = [case.outcome for case in cases]
    kinds = {"failures": "failure", "skipped": "skipped", "errors": "error"}
    counts = {"tests": len(outcomes)} | {n: outcomes.count(kind) for n, kind in kinds.items()}
    return {"name": suite} | {name: str(n) for name, n in counts.items()}


def _clean(text: str) -> str:
    """Return a text without characters that XML cannot hold: a file's name may have any."""
    return _NO_XML.sub(lambda found: found[0].encode("unicode_escape").decode(), text)
