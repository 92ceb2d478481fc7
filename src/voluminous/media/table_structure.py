"""What of a table may be seen, and how narrow it is there."""

from __future__ import annotations

import numpy as np

# Structures are looked at in classes of width, each so much wider than the one before.
_CLASS, _CLASSES = 8.0, 3
# So many jumps are looked for exactly, the largest: each takes its part of every kernel.
_JUMPS = 4


def visible_range(nodes: np.ndarray, columns: np.ndarray, faint: float) -> tuple[float, float]:
    """Return between which x an entry may exceed `faint`; (∞, -∞) if none does.

    Parameters
    ----------
    nodes : array, shape (n,)
        Increasing places of the entries.
    columns : array, shape (n, m)
        The entries, at most one.
    faint : float
        What may be neglected.
    """
    seen = np.flatnonzero((np.abs(columns) > faint).any(axis=1))
    if not len(seen):
        return np.inf, -np.inf
    first, last = int(seen[0]), int(seen[-1])
    return (
        float(nodes[first - 1]) if first > 0 else -np.inf,
        float(nodes[last + 1]) if last < len(nodes) - 1 else np.inf,
    )


def structures(nodes: np.ndarray, columns: np.ndarray) -> list[tuple[float, float, float]]:
    """Return width, least and greatest x of the table's structures, the narrowest first.

    The width of a piece between two nodes is how far x goes, at its rate, for a change of one; a
    jump at an end counts as change. Pieces of similar width are one structure, whose ends are those
    of its pieces.
    """
    steps = np.diff(nodes)
    jumps = np.abs(np.diff(columns, axis=0)).max(axis=1)
    alone = np.where(steps > 0, 0.0, jumps)
    change = jumps + np.append(alone[1:], 0.0) + np.append(0.0, alone[:-1])
    some = (steps > 0) & (change > 0)
    width = steps[some] / change[some]
    low, high = nodes[:-1][some], nodes[1:][some]
    found: list[tuple[float, float, float]] = []
    while len(width) and len(found) < _CLASSES:
        least = float(width.min())
        near = width < _CLASS * least
        found.append((least, float(low[near].min()), float(high[near].max())))
        width, low, high = width[~near], low[~near], high[~near]
    return found


def jumps(nodes: np.ndarray, columns: np.ndarray) -> list[float]:
    """Return where entries jump, at two equal nodes: the largest of these jumps first."""
    change = np.where(np.diff(nodes) > 0, 0.0, np.abs(np.diff(columns, axis=0)).max(axis=1))
    largest = np.argsort(-change, kind="stable")[:_JUMPS]
    return [float(nodes[k]) for k in largest if change[k] > 0]
