"""Which triangles share an edge, and which way round they go.

Notation
F            number of triangles
half-edge    3f + k: edge k of triangle f, from its vertex k to its vertex (k + 1) mod 3
partner      the other half-edge on the same two vertices, where exactly two triangles meet there
part         triangles that can be reached from one another across partnered edges
fan          corners at one vertex that can be reached from one another across opposed edges there

Winding is a two-colouring. Each triangle is two nodes, as given and flipped; an edge whose sides run opposite ways (as
they should) joins like nodes, any other joins unlike ones. Where both nodes of a triangle end up connected, the surface
is one-sided (a Möbius band) and has no winding to agree on. This is linear in F, with no loop over triangles.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

#: A closed part is inside out when its volume is below minus this share of (its area)^1.5, so not by rounding alone.
MIN_VOLUME = 1e-9


class Edges(NamedTuple):
    """For each half-edge: its partner (-1: none), whether the two run opposite ways, and how many triangles meet."""

    partner: Int[np.ndarray, "F 3"]
    opposed: Bool[np.ndarray, "F 3"]
    crowd: Int[np.ndarray, "F 3"]


class Winding(NamedTuple):
    """flip: triangles to turn over, the fewer of each part; part: its number; one_sided: none to agree on."""

    flip: Bool[np.ndarray, "F"]
    part: Int[np.ndarray, "F"]
    one_sided: Bool[np.ndarray, "F"]


def pair_edges(faces: Int[np.ndarray, "F 3"]) -> Edges:
    """Match the half-edges of triangles whose three corners differ."""
    tail, head = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    key = np.minimum(tail, head) * (faces.max(initial=0) + 1) + np.maximum(tail, head)
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    sizes = np.diff(starts, append=len(key))
    first, second = order[starts[sizes == 2]], order[starts[sizes == 2] + 1]
    partner = np.full(len(key), -1)
    partner[first], partner[second] = second, first
    crowd = np.empty(len(key), np.int64)
    crowd[order] = np.repeat(sizes, sizes)
    opposed = (partner >= 0) & (tail == head[partner])
    return Edges(partner.reshape(-1, 3), opposed.reshape(-1, 3), crowd.reshape(-1, 3))


def split_fans(
    faces: Int[np.ndarray, "F 3"], edges: Edges, count: int
) -> tuple[Int[np.ndarray, "F 3"], Int[np.ndarray, "X"]]:
    """Faces whose every vertex has one fan, and the vertices that the new ones, count + 0 ... X − 1, are copies of."""
    side = np.flatnonzero(edges.opposed)
    other = edges.partner.ravel()[side]
    after = side - side % 3 + (side + 1) % 3
    corners = coo_array((np.ones(len(side), np.int8), (after, other)), shape=(faces.size, faces.size))
    fan = connected_components(corners, directed=False)[1]
    first = np.unique(fan, return_index=True)[1]
    order = np.lexsort((first, faces.ravel()[first]))
    vertex = faces.ravel()[first[order]]
    copy = np.append(False, vertex[1:] == vertex[:-1])
    number = np.empty(len(first), np.int64)
    number[order] = np.where(copy, count + np.cumsum(copy) - 1, vertex)
    return number[fan].reshape(-1, 3), vertex[copy]


def agree(edges: Edges) -> Winding:
    """The fewest triangles to turn over so that all that can agree with their neighbours do."""
    partner, opposed = edges.partner.ravel(), edges.opposed.ravel()
    count = len(edges.partner)
    one = np.flatnonzero(partner > np.arange(len(partner)))
    f, g, unlike = one // 3, partner[one] // 3, count * ~opposed[one]
    rows = np.concatenate([f, f + count])
    columns = np.concatenate([g + unlike, g + count - unlike])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1].reshape(2, count)
    part = np.unique(label.min(axis=0), return_inverse=True)[1]
    turned = label[0] > label[1]
    mostly_turned = np.bincount(part, turned) * 2 > np.bincount(part)
    return Winding(turned ^ mostly_turned[part], part, label[0] == label[1])


def inside_out(
    points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], part: Int[np.ndarray, "F"], edges: Edges
) -> Bool[np.ndarray, "K"]:
    """Closed parts whose volume is negative, with all that lies inside their bounding boxes.

    A closed part inside the bounding box of another is taken for a cavity of it (negative by right) and keeps its
    place relative to that other part.
    """
    count = part.max() + 1
    closed = np.bincount(part, (~edges.opposed).sum(axis=1), count) == 0
    start = np.zeros(count, np.int64)
    start[part[::-1]] = np.arange(len(part))[::-1]
    corner = points[faces] - points[faces[start, 0]][part][:, None]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    volume = np.bincount(part, np.einsum("fi,fi->f", corner[:, 0], normal) / 6, count)
    area = np.bincount(part, np.linalg.norm(normal, axis=1) / 2, count)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, part, points[faces].min(axis=1))
    np.maximum.at(high, part, points[faces].max(axis=1))
    flip = np.zeros(count, bool)
    for i in np.flatnonzero(closed & (volume < -MIN_VOLUME * area**1.5)):
        contains = closed & (low < low[i]).all(axis=1) & (high > high[i]).all(axis=1)
        if not contains.any():
            flip |= closed & (low >= low[i]).all(axis=1) & (high <= high[i]).all(axis=1)
    return flip
