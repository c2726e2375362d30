# SPDX-License-Identifier: Apache-2.0
"""rows.py: the Markdown tables of scripts whose rows may have failed."""


def print_table(head, rows):
    """Prints rows (name, variant, cells) below their titles; returns the number of those without cells."""
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for name, variant, cells in rows:
        print(f"| {name} | {variant} | " + " | ".join(cells or ["failed"] * (len(head) - 2)) + " |")
    print()
    return sum(1 for row in rows if row[2] is None)
