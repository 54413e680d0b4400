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
    """Write the pages."""
    import pdoc

    import excite

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", dest="out", type=Path, default=ROOT / "build" / "reference")
    arguments = parser.parse_args()
    # pdoc does not call the module's __getattr__, which imports the public names on first use
    vars(excite).update({name: getattr(excite, name) for name in excite.__all__})
    pdoc.render.configure(docformat="google")
    pdoc.pdoc("excite", "!excite.api", output_directory=arguments.out)
    print(f"wrote {arguments.out / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
