"""Schemas of the documents that excite reads, checked before anything is computed.

Each module describes one document as msgspec structs: types, ranges with units, and conditions on
several values together. `document_file` reads a file and reports its first fault as
`UnusableInput`.

Documents that excite writes (trajectory, model, truth, recording sidecar) may hold further keys,
which later versions add. Documents that people write (limits, scene, prior, bounds) may not: there
an unknown key is a spelling error.

These modules are imported when a file is read, so that `excite --help` does not load msgspec.
"""
