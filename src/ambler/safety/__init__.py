"""The velocity gate: the last word on every command that reaches a base. Pure objects, no time of their own."""
