"""The parser: a sentence becomes a record, or a refusal with its column.

The language itself is `rtc.language`.
"""
