"""The code of a run."""

from pathlib import Path

from training.jobs.run_folder import code_sha256


def test_the_code_of_a_run_is_another_after_a_change_of_any_source(tmp_path: Path) -> None:
    # GIVEN a folder of sources and numbers beside those of the product
    (tmp_path / "a.py").write_text("x = 1\n")
    (tmp_path / "numbers.toml").write_text("x = 1\n")
    found = [code_sha256(), code_sha256(tmp_path)]
    # WHEN one after the other changes THEN the digest does; other files do not count
    for name, text in (("a.py", "x = 2\n"), ("numbers.toml", "x = 2\n"), ("notes.txt", "")):
        (tmp_path / name).write_text(text)
        code_sha256.cache_clear()
        found.append(code_sha256(tmp_path))
    assert len(set(found)) == 4
    assert found[-1] == found[-2]
