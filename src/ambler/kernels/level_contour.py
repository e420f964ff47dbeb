"""Contours of a clearance field at one level, and their corners.

A field is uint8 [iy, ix]: the distance to the nearest forbidden cell centre in sixteenths of a cell (`UNIT`), capped at 255. Marching
squares follow the curve where the bilinear field equals the level, with what is closer on the left; Douglas and Peucker's method leaves
its corners. Coordinates are (y, x) in cells, whole numbers at cell centres.
"""

import numpy as np

from ambler.kernels.jit import jit

UNIT = 16.0


@jit
def _crossing(field, level, y, x, is_vertical, out):
    """The point of the curve on the lattice edge from (y, x) to (y, x + 1), or to (y + 1, x) when it is vertical."""
    a = float(field[y, x])
    b = float(field[y + 1, x]) if is_vertical else float(field[y, x + 1])
    share = (level - a) / (b - a)
    out[0] = y + (share if is_vertical else 0.0)
    out[1] = x + (0.0 if is_vertical else share)


@jit
def _next_side(field, level, y, x, entered):
    """Return by which side (0 low y, 1 high x, 2 high y, 3 low x) the curve leaves the lattice square whose lowest corner is (y, x)."""
    a, b = field[y, x] < level, field[y, x + 1] < level
    c, d = field[y + 1, x + 1] < level, field[y + 1, x] < level
    crossed = (a != b, b != c, c != d, d != a)
    count = int(crossed[0]) + int(crossed[1]) + int(crossed[2]) + int(crossed[3])
    if count == 4:
        middle = float(field[y, x]) + float(field[y, x + 1]) + float(field[y + 1, x + 1]) + float(field[y + 1, x])
        is_joined = (0.25 * middle < level) == a  # the corners a and c are of one piece
        if is_joined:
            pairs = (1, 0, 3, 2)  # sides 0-1 cut off b, sides 2-3 cut off d
        else:
            pairs = (3, 2, 1, 0)
        return pairs[entered]
    for side in range(4):
        if side != entered and crossed[side]:
            return side
    return -1


@jit
def _follow(field, level, y, x, entered, box, visited, points):
    """Follow the curve from the square (y, x), entered by a side, until it closes or leaves the box; returns (points, is_closed)."""
    y0, y1, x0, x1 = box
    first_y, first_x, first_side = y, x, entered
    n = 0
    while n < len(points):
        side = _next_side(field, level, y, x, entered)
        if side < 0:
            return n, False
        if side == 0:
            _crossing(field, level, y, x, False, points[n])
            y, entered = y - 1, 2
        elif side == 1:
            _crossing(field, level, y, x + 1, True, points[n])
            visited[y - y0, x + 1 - x0] = 1
            x, entered = x + 1, 3
        elif side == 2:
            _crossing(field, level, y + 1, x, False, points[n])
            y, entered = y + 1, 0
        else:
            _crossing(field, level, y, x, True, points[n])
            visited[y - y0, x - x0] = 1
            x, entered = x - 1, 1
        n += 1
        if y == first_y and x == first_x and entered == first_side:
            return n, True
        if y < y0 or y >= y1 - 1 or x < x0 or x >= x1 - 1:
            return n, False
    return n, False


@jit
def trace(field, level, y0, y1, x0, x1, points, starts, closed):
    """Write the curves of the level inside rows y0 ... y1 - 1 and columns x0 ... x1 - 1 into `points` (M, 2); curve k is
    points[starts[k] : starts[k + 1]], `closed[k]` says whether it closes. Each has what is closer on its left hand, seen with x to the
    right and y up. Returns how many there are, -1 when an array is too small."""
    box = (y0, y1, x0, x1)
    visited = np.zeros((y1 - y0, x1 - x0), np.uint8)
    back = np.empty((4 * (y1 - y0) * (x1 - x0) + 8, 2)) if (y1 - y0) * (x1 - x0) < 4096 else np.empty((len(points), 2))
    found, used = 0, 0
    starts[0] = 0
    for y in range(y0, y1 - 1):
        for x in range(x0, x1):
            low, high = field[y, x] < level, field[y + 1, x] < level
            if low == high or visited[y - y0, x - x0]:
                continue
            visited[y - y0, x - x0] = 1
            if found + 2 > len(starts) or used + 1 >= len(points):
                return -1
            # The curve crosses this lattice edge towards +x when what is closer lies above it (on the left), else towards -x.
            forward = x if high else x - 1
            backward = x - 1 if high else x
            side, other = (3, 1) if high else (1, 3)
            n, is_closed = 0, False
            first = used
            _crossing(field, level, y, x, True, points[used])
            used += 1
            if x0 <= forward < x1 - 1:
                n, is_closed = _follow(field, level, y, forward, side, box, visited, points[used:])
                if is_closed:
                    n -= 1  # its last point is the first one again
                used += n
            if not is_closed and x0 <= backward < x1 - 1:
                m, _ = _follow(field, level, y, backward, other, box, visited, back)
                if used + m >= len(points):
                    return -1
                for k in range(used - first - 1, -1, -1):
                    points[first + m + k] = points[first + k]
                for k in range(m):
                    points[first + m - 1 - k] = back[k]
                used += m
            if used >= len(points) - 1:
                return -1
            closed[found] = is_closed
            found += 1
            starts[found] = used
    return found


@jit
def _furthest(points, a, b, n):
    """Return the point between two others of a chain that lies furthest from their chord, and its squared distance."""
    ay, ax = points[a % n, 0], points[a % n, 1]
    dy, dx = points[b % n, 0] - ay, points[b % n, 1] - ax
    length2 = dy * dy + dx * dx
    best, at = -1.0, a
    for k in range(a + 1, b):
        py, px = points[k % n, 0] - ay, points[k % n, 1] - ax
        if length2 > 1e-18:
            share = min(1.0, max(0.0, (py * dy + px * dx) / length2))
            py, px = py - share * dy, px - share * dx
        d2 = py * py + px * px
        if d2 > best:
            best, at = d2, k
    return at, best


@jit
def simplify(points, is_closed, tolerance, keep):
    """Mark in `keep` bool (N,) the corners that Douglas and Peucker's method leaves of one curve (N, 2) within a tolerance in cells."""
    n = len(points)
    keep[:] = False
    stack = np.empty((n + 4, 2), np.int64)
    if is_closed:
        first = 0
        for k in range(n):  # a start that does not depend on where the tracing began
            if points[k, 0] < points[first, 0] or (
                points[k, 0] == points[first, 0] and points[k, 1] < points[first, 1]
            ):
                first = k
        far, best = first, -1.0
        for k in range(n):
            d2 = (points[k, 0] - points[first, 0]) ** 2 + (points[k, 1] - points[first, 1]) ** 2
            if d2 > best:
                best, far = d2, k
        far = far if far > first else far + n
        keep[first], keep[far % n] = True, True
        stack[0, 0], stack[0, 1] = first, far
        stack[1, 0], stack[1, 1] = far, first + n
        size = 2
    else:
        keep[0], keep[n - 1] = True, True
        stack[0, 0], stack[0, 1] = 0, n - 1
        size = 1
    while size > 0:
        size -= 1
        a, b = stack[size, 0], stack[size, 1]
        if b - a < 2:
            continue
        at, d2 = _furthest(points, a, b, n)
        if d2 > tolerance * tolerance:
            keep[at % n] = True
            stack[size, 0], stack[size, 1] = a, at
            stack[size + 1, 0], stack[size + 1, 1] = at, b
            size += 2


@jit
def corners(points, is_closed, least_turn, out):
    """Write the corners of a simplified curve (N, 2) around which a path can bend: where it turns left, towards what is closer, by more than
    `least_turn` (rad). A row is (y, x, y and x of the direction back, y and x of the direction on). Returns their number."""
    n = len(points)
    count = 0
    for k in range(n):
        if not is_closed and (k == 0 or k == n - 1):
            continue
        i, j = (k - 1) % n, (k + 1) % n
        by, bx = points[i, 0] - points[k, 0], points[i, 1] - points[k, 1]
        fy, fx = points[j, 0] - points[k, 0], points[j, 1] - points[k, 1]
        b, f = np.hypot(by, bx), np.hypot(fy, fx)
        if b < 1e-9 or f < 1e-9:
            continue
        by, bx, fy, fx = by / b, bx / b, fy / f, fx / f
        turn = np.arctan2(-bx * fy + by * fx, -bx * fx - by * fy)
        if n == 2 or turn > least_turn:
            out[count, 0], out[count, 1] = points[k, 0], points[k, 1]
            out[count, 2], out[count, 3], out[count, 4], out[count, 5] = by, bx, fy, fx
            count += 1
    return count


@jit
def narrow_cells(field, level, least, y0, y1, x0, x1, out):
    """Write the cells (y, x) that lie in the middle of a gap too narrow for the level: at least `least` (both in field units) themselves,
    with less on both sides in one of four directions and no less along the gap. Returns their number (at most len(out))."""
    count = 0
    height, width = field.shape
    for y in range(max(4, y0), min(height - 4, y1)):
        for x in range(max(4, x0), min(width - 4, x1)):
            v = field[y, x]
            if v < least or v >= level:
                continue
            for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
                if not (field[y + 2 * dy, x + 2 * dx] < v and field[y - 2 * dy, x - 2 * dx] <= v):
                    continue
                if field[y + dy, x + dx] > v or field[y - dy, x - dx] > v:
                    continue
                if field[y + 3 * dx, x - 3 * dy] < v - 8 or field[y - 3 * dx, x + 3 * dy] < v - 8:
                    continue
                is_new = True
                for k in range(count - 1, max(-1, count - 40), -1):
                    if abs(out[k, 0] - y) <= 3 and abs(out[k, 1] - x) <= 3:
                        is_new = False
                        break
                if is_new and count < len(out):
                    out[count, 0], out[count, 1] = y, x
                    count += 1
                break
    return count


def warm_up() -> None:
    """Compile every kernel with the types it is used with."""
    field = np.full((12, 12), 255, np.uint8)
    field[4:8, 4:8] = 0
    points, starts, closed = np.empty((200, 2)), np.empty(20, np.int64), np.empty(20, np.bool_)
    n = trace(field, 20.5, 0, 12, 0, 12, points, starts, closed)
    curve = points[: starts[1]] if n > 0 else points[:4]
    keep = np.empty(len(curve), np.bool_)
    simplify(curve, True, 0.5, keep)
    corners(curve[keep], True, 0.1, np.empty((len(curve), 6)))
    narrow_cells(field, 26.0, 14.0, 0, 12, 0, 12, np.empty((10, 2), np.int64))
