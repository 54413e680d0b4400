"""Optimal excitation trajectories for robot identification.

The functions that `__init__.pyi` lists do what the commands of the same names do; the packages
behind them offer more control. Each is imported when it is first used: `import excite` is quick.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, _public_names, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __dir__() -> list[str]:
    return sorted([*_public_names(), "__version__"])
