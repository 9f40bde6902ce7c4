"""The command language: grammar, lexer, parser, dictionary, completion and error messages.

From one sentence to its record (`ParsedCommand`) or a located refusal. This package knows neither the cell nor the
world: it does not look up whether a name exists.
"""
