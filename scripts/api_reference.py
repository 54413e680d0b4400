"""Write the reference of the public interface as HTML, from the docstrings.

    python scripts/api_reference.py [-o build/reference]

Needs pdoc, which `pip install -e '.[dev]'` installs.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    """Render every public module of the package."""
    import pdoc

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", dest="out", type=Path, default=ROOT / "build" / "reference")
    arguments = parser.parse_args()
    pdoc.render.configure(docformat="google")
    pdoc.pdoc("excite", "excite.api", output_directory=arguments.out)
    print(f"wrote {arguments.out / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
