"""Run a benchmark: ``python -m benchmarks NAME [options]``; without a name, list them all.

A benchmark is a module anywhere below this folder with ``main(argv) -> int`` at its top level.
"""

import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from monitor.base.errors import O2Error

FOLDER = Path(__file__).parent


def benchmarks() -> dict[str, tuple[str, str]]:
    """Return module and first line of the docstring of each benchmark; nothing is imported."""
    found: dict[str, tuple[str, str]] = {}
    for path in sorted(FOLDER.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        mains = [n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == "main"]
        if path.stem == "__main__" or not mains:
            continue
        module = ".".join(path.relative_to(FOLDER.parent).with_suffix("").parts)
        if path.stem in found:
            raise SystemExit(f"two benchmarks of one name: {found[path.stem][0]}, {module}")
        found[path.stem] = module, (ast.get_docstring(tree) or "").partition("\n")[0]
    return found


def main(argv: Sequence[str]) -> int:
    """List the benchmarks, or run one and return its exit code."""
    found = benchmarks()
    name = argv[0] if argv else "--help"
    if name in ("-h", "--help"):
        print("usage: python -m benchmarks NAME [options]; NAME --help tells the options")
        folder = ""
        for name, (module, line) in sorted(found.items(), key=lambda item: item[1]):
            if module.split(".")[1] != folder:
                folder = module.split(".")[1]
                print(f"\n{folder}")
            print(f"  {name:<24}{line}")
        return 0
    if name not in found:
        print(f"no benchmark {name}; python -m benchmarks lists them", file=sys.stderr)
        return 2
    try:
        code: int = import_module(found[name][0]).main(argv[1:])
    except O2Error as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
