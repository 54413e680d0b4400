"""Public interface: the functions behind the commands, for use in Python.

Every function takes paths as `str` or `Path` and robots as a path, a built-in name or a loaded
`Robot`, and returns a result with `save` and `report`. The names, which are also those of `excite`,
are listed in `__init__.pyi`; the module of a name is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
