"""Schemas of the documents that excite reads, checked before anything is computed.

Each module describes one document as msgspec structs: types, ranges with units, and conditions on
several values together.
`document_file` reads a file and turns whatever is wrong with it into one `UnusableInput`.

Documents that excite writes (trajectory, model, truth, recording sidecar) may hold further keys,
which later versions add. Documents that people write (limits, scene, prior, bounds) may not: there
an unknown key is a typing error.

Nothing here is imported before a file is read: `excite --help` does without msgspec.
"""
