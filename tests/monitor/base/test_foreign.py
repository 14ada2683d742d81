"""A plug-in that fails in any way is named in one clean line."""

from collections.abc import Callable

import pytest

from monitor.base.foreign import ForeignError, foreign, one_line, returned


class OddError(BaseException):
    pass


def raising(error: BaseException) -> Callable[[], object]:
    def call() -> object:
        raise error

    return call


@pytest.mark.parametrize(
    "error", [SystemExit(0), SystemExit("bye"), OddError("odd"), ValueError("bad"), RuntimeError()]
)
def test_whatever_a_plug_in_raises_is_an_error_that_names_it(error: BaseException) -> None:
    with pytest.raises(ForeignError, match=r"^shop\.rule fails: ") as caught:
        returned("shop.rule", raising(error), str)
    assert caught.value.__cause__ is error


@pytest.mark.parametrize("found", [None, "text", 7, iter(())])
def test_what_is_no_result_is_named_with_what_was_wanted(found: object) -> None:
    kind = type(found).__name__
    with pytest.raises(ForeignError, match=f"shop.rule returned {kind}, dict is wanted"):
        returned("shop.rule", lambda: found, dict)
    assert returned("shop.rule", lambda: {"a": 1}, dict) == {"a": 1}


def test_an_interrupt_of_the_user_passes() -> None:
    with pytest.raises(KeyboardInterrupt), foreign("shop.rule"):
        raise KeyboardInterrupt


@pytest.mark.parametrize("text", ["\x1b[2J", "bell\a", "\u202e txt", "two\nlines", "lone \udc80"])
def test_no_text_of_others_moves_the_terminal(text: str) -> None:
    assert one_line(text).isprintable()
