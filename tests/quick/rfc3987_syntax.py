"""Not the package of this name: it compiles a grammar for two seconds whenever it is imported.

`jsonschema` imports it where it can, to check addresses that nothing here has; without it a
process that reads a notebook starts in a third of the time. Only the tests' own processes see
this file.
"""

raise ImportError("rfc3987_syntax: left out of the tests, which need no check of addresses")
