"""Fixed interpreted Python over strings, a dictionary and calls; as a program, with the start of numpy."""

STEPS = 100_000


def interpret(count: int = STEPS) -> int:
    """Do the work of one slice, a tenth of a second."""
    table: dict[str, int] = {}
    for k in range(count):
        name = f"{k % 997:04d}"
        parts = [name[1:], name[:2]]
        table[name] = table.get(name, 0) + len("-".join(parts))
        if isinstance(parts, list) and len(table) > 900:
            parts.append("".join(sorted(parts)))
    return sum(table.values())


if __name__ == "__main__":
    import numpy  # noqa: F401

    interpret(STEPS // 2)
