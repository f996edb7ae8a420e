"""A slanted edge as MTF Mapper measures one: the best public tool's published method, written anew as a rival to compare with.

F. van den Bergh, MTF Mapper (its papers, blog and public source, "loess" edge model): the edge's ridge by gradients, two
parabolas along it, 8 samples a px of the edge response by local regression of order 6, tails ever more smoothed by their
noise, central differences, FFT, a smoothed transfer. Its constants are the tool's. Imports nothing of the package.
"""

import numpy as np

PER_PIXEL, SIZE, REACH = 8, 512, 28  # samples of the edge response: a px, in all; px on both sides of the edge
MIDDLE = SIZE // 2
_SPAN, _ORDER, _FALL = 4.5, 6, 13.5  # px, order and decay of the local regression
_RIDGE = (
    (4, 95), (5, 92), (6, 89), (7, 86), (8, 83), (9, 79), (10, 76), (12, 70), (14, 63), (16, 58), (18, 53), (20, 49),
    (22, 46), (24, 43), (26, 42), (28, 40), (30, 39), (35, 38), (40, 38), (45, 36), (50, 34), (60, 30), (70, 27), (80, 22),
    (90, 14), (100, 7), (124, 2), (149, 2), (794, 1), (894, 1), (1000, 5e-8),
)  # fmt: skip
_TAILS = (
    (4, 27), (5, 26), (6, 25), (8, 24), (9, 23), (10, 22), (12, 22), (14, 21), (16, 20), (18, 20), (20, 19), (24, 19),
    (26, 18), (28, 18), (30, 17), (35, 16), (40, 16), (45, 15), (50, 14), (60, 12), (70, 12), (80, 11), (90, 10), (100, 9),
    (124, 8), (174, 7), (298, 7), (398, 6), (497, 6), (596, 5), (696, 4), (794, 4),
)  # fmt: skip
_FEET = (
    (100, 8),
    (124, 8),
    (149, 7),
    (174, 7),
    (199, 6),
    (298, 5),
    (398, 4),
    (497, 3),
    (696, 3),
    (794, 2),
    (894, 2),
    (1000, 0),
)
_CORE = (
    (4, 7), (5, 6), (6, 6), (7, 5), (10, 5), (12, 4), (16, 4), (18, 3), (30, 3), (35, 2), (60, 2), (70, 1), (199, 1), (298, 0),
)  # fmt: skip
"""How much is smoothed, by the contrast over the noise: in the regression, in the tails, at the feet, about the core."""


def _by(table, contrast_over_noise):
    return float(np.interp(contrast_over_noise, *np.array(table, float).T))


# ---------------------------------------------------------------- where the edge runs


def _gradient(picture):
    """Squared gradient of the smoothed picture."""
    taps = np.exp(-((np.arange(-2, 3) / 1.2) ** 2) / 2)
    taps /= taps.sum()
    height, width = picture.shape
    padded = np.pad(picture, 2, mode="reflect")
    rows = sum(t * padded[:, i : i + width] for i, t in enumerate(taps))
    smooth = sum(t * rows[i : i + height] for i, t in enumerate(taps))
    across, along = np.zeros_like(smooth), np.zeros_like(smooth)
    across[:, 1:-1] = smooth[:, 2:] - smooth[:, :-2]
    along[1:-1] = smooth[2:] - smooth[:-2]
    return across**2 + along**2


def _line(points, weight):
    """Centroid, and the normal of the longest axis."""
    centre = weight @ points / weight.sum()
    off = points - centre
    _, axes = np.linalg.eigh((off * weight[:, None]).T @ off)
    return centre, axes[:, 0]


def _refined_line(points, steep):
    """Line through the steepest points: all of them first, then those near the ridge, by a much higher power."""
    weight = steep / steep.max()
    centre, normal = _line(points, weight)
    across = (points - centre) @ normal
    at = np.rint(across * PER_PIXEL).astype(int) + 16 * PER_PIXEL
    size = 2 * 16 * PER_PIXEL
    inside = (at >= 3) & (at < size - 3)
    histogram = np.convolve(np.bincount(at[inside], weight[inside], size), np.ones(7), "same")
    peak = 11 * PER_PIXEL + int(histogram[11 * PER_PIXEL : 21 * PER_PIXEL + 1].argmax())
    low = histogram <= 0.05 * histogram[peak]
    first, last = np.flatnonzero(low[:peak]), np.flatnonzero(low[peak:])
    first, last = (first[-1] if first.size else 1), (peak + last[0] if last.size else size - 1)
    total = np.cumsum(histogram)
    ends = np.array([np.abs(total - q * total[-1]).argmin() for q in (0.1, 0.9)]) / PER_PIXEL - 16
    reach = 0.7 * (ends[1] - ends[0])
    lower = max((first - 4) / PER_PIXEL - 16, ends[0] - reach)
    upper = min((last + 4) / PER_PIXEL - 16, ends[1] + reach)
    return _line(points, np.where((across >= lower) & (across <= upper), weight**4 / (10 + np.abs(across)), 0.0))


def _spoilt(points, steep, centre, normal):
    """Pixels away from the edge whose gradient is among the largest 5 % at their distance, where one stands out."""
    across = (points - centre) @ normal
    group = np.rint(2 * across).astype(int)
    bad = np.zeros(len(points), bool)
    for g in np.unique(group):
        here = np.flatnonzero((group == g) & (np.abs(across) > 2))
        if here.size > 3:
            ordered = np.sort(steep[here])
            if ordered[-1] - ordered[-2] >= 0.001 * steep.max():
                bad[here] = steep[here] >= ordered[int(0.95 * ordered.size)]
    return bad


def _ridge(points, steep, centre, normal):
    """Places (along, across) of the ridge px by px."""
    off = points - centre
    along, across = off @ np.array([-normal[1], normal[0]]), off @ normal
    at = np.rint(along).astype(int)
    at -= at.min()
    weight = (steep / steep.max()) ** 4
    sums = np.array([np.bincount(at, weight * q) for q in (along, across, np.ones_like(along))])
    sums = sums[:, np.bincount(at) > 12]
    smooth = np.array([np.convolve(row, np.ones(5), "same") for row in sums])
    positions = smooth[:2] / smooth[2]
    step = np.abs(np.diff(positions[1]))
    quarter = positions.shape[1] // 4
    usual = step[quarter : 3 * quarter]
    far = np.abs(step - usual.mean()) > 2 * usual.std(ddof=1)
    first, last = 0, positions.shape[1]
    while first < quarter and far[first]:
        first += 1
    while last > 3 * quarter and far[last - 2]:
        last -= 1
    return positions[:, first:last]


def _distances(points, ridge, centre, normal):
    """Distance of every pixel from two parabolas that meet smoothly."""
    join = 1.0
    t, position = ridge
    powers = np.stack([t**2, t, np.ones_like(t)], -1)
    design = np.hstack([powers * (t <= join)[:, None], powers * (t > join)[:, None]])
    meet = np.array([[join**2, join, 1], [2 * join, 1, 0]])
    meet = np.hstack([meet, -meet])
    system = np.block([[design.T @ design, meet.T], [meet, np.zeros((2, 2))]])
    both = np.linalg.lstsq(system, np.append(design.T @ position, [0, 0]), rcond=None)[0][:6]
    off = points - centre
    along, across = off @ np.array([-normal[1], normal[0]]), off @ normal
    a, b, c = np.where((along < join)[:, None], both[:3], both[3:]).T
    foot = along.copy()
    for _ in range(6):  # Newton's steps to the nearest point
        gap, slope = across - (a * foot**2 + b * foot + c), 2 * a * foot + b
        foot -= (foot - along - gap * slope) / (1 - 2 * a * gap + slope**2)
    gap = across - (a * foot**2 + b * foot + c)
    return np.copysign(np.hypot(foot - along, gap), gap)


# ---------------------------------------------------------------- edge response


def _first_response(distance, value, left, right):
    """Triangles about each sample; NaN where there is nothing."""
    total, weight = np.zeros(SIZE), np.zeros(SIZE)
    at = np.trunc(distance * PER_PIXEL + MIDDLE).astype(int)
    for k in range(-5, 6):
        b = at + k
        w = np.maximum(1 - np.abs(distance - (b - MIDDLE) / PER_PIXEL) * 1.75, 0.0)
        w *= (b >= max(left, 0)) & (b <= min(right - 1, SIZE - 1))
        b = np.clip(b, 0, SIZE - 1)
        np.add.at(total, b, w * value)
        np.add.at(weight, b, w)
    there = np.flatnonzero(weight > 0)
    mean = total[there] / weight[there]
    # what is beyond the last one is as it is
    return np.interp(np.arange(SIZE), there, mean)


def _slopes(response):
    """Slope of a line through 33 samples."""
    j = np.arange(-16, 17)
    slopes = np.zeros(SIZE)
    slopes[16:-16] = np.correlate(response, j / (j**2).sum(), "valid")
    return slopes


def _clipped(slopes, left, right):
    """Range of samples before the slope changes its sign for good."""
    centre = slopes[MIDDLE - 16 : MIDDLE + 17]
    peak = centre[np.abs(centre).argmax()]
    relative = slopes / peak
    for side, order in ((0, range(MIDDLE - 16, left + 3, -1)), (1, range(MIDDLE + 16, right - 4))):
        for i in order:
            if relative[i] < -0.001:
                beyond = relative[left : i + 1] if side == 0 else relative[i:right]
                share, most = (beyond < 0).mean(), max(-beyond.min(), 0.0)
                if (share > 0.4 and most > 0.25) or (share > 0.9 and beyond.size > 16):
                    if side == 0:
                        left = min(i, MIDDLE - 16)
                    else:
                        right = max(i, MIDDLE + 16)
                    break
    return left, right


class _Width:
    """Half width of the transition, in samples; contrast; contrast over noise; the range that is used."""

    def __init__(self, distance, value):
        left, right = MIDDLE - PER_PIXEL * REACH, MIDDLE + PER_PIXEL * REACH
        for _ in range(3):
            response = _first_response(distance, value, left, right)
            before = left, right
            left, right = _clipped(_slopes(response), left, right)
            if (left, right) == before:
                break
        self.left, self.right = left, right
        i = np.arange(SIZE)
        low_side = response[(i >= left) & (i < max(MIDDLE - SIZE // 8, left + 16))].mean()
        high_side = response[(i <= right) & (i > min(MIDDLE + SIZE // 8, right - 16))].mean()
        smooth = np.convolve(response, np.ones(5) / 5, "same")
        share = (smooth[left : right + 1] - low_side) / (high_side - low_side)
        ends = [left + int(np.abs(share - q).argmin()) for q in (0.1, 0.9)]
        rise = max(4.0, abs(ends[1] - ends[0]) / PER_PIXEL)
        more = 4 + 2 * round(rise)
        self.half = max(abs(min(ends) - more - MIDDLE), abs(max(ends) + more - MIDDLE))
        tail = response.copy()
        for i in range(left, right):
            if abs(i - MIDDLE) > 1.85 * self.half:
                tail[i] = response[max(i - 16, 0) : i + 17].mean()
        self.contrast = abs(tail[right - 16 : right].mean() - tail[left : left + 16].mean())
        far = max(2 * self.half / PER_PIXEL, 0)
        noise = []
        ends = max((left - MIDDLE) / PER_PIXEL, distance[0]), min((right - MIDDLE) / PER_PIXEL, distance[-1])
        for side in (
            (distance >= ends[0]) & (distance < max(ends[0] + 2, -far)),
            (distance <= ends[1]) & (distance > min(ends[1] - 2, far)),
        ):
            at = np.clip(np.trunc(distance[side] * PER_PIXEL + 0.5 + MIDDLE).astype(int), left, right)
            noise.append(np.mean((tail[at] - value[side]) ** 2))
        self.over_noise = min(self.contrast / max(np.sqrt(np.mean(noise)), 1e-9 * self.contrast), 1e4)


def _response(distance, value):
    """Edge response at `SIZE` samples, and how it was made."""
    of = _Width(distance, value)
    mean, there = np.zeros(SIZE), np.zeros(SIZE, bool)
    reach, ridge = of.half / PER_PIXEL, _by(_RIDGE, of.over_noise)
    first = int(distance[0] * PER_PIXEL) + MIDDLE + 1
    for b in range(max(first, 1), min(int(distance[-1] * PER_PIXEL) + MIDDLE - 1, SIZE)):
        middle = (b - MIDDLE) / PER_PIXEL
        i, j = np.searchsorted(distance, [middle - _SPAN / 2, middle + _SPAN / 2])
        if j - i < _ORDER + 1:
            continue
        if abs(middle) < reach + 3 / PER_PIXEL:
            x = distance[i:j] - middle
            flat = 0.125 if abs(middle) < reach / 2 else 0.25
            w = np.where(np.abs(x) < flat, 1.0, np.exp(-np.abs(np.abs(x) - flat) * _FALL))
            design = w[:, None] * np.polynomial.chebyshev.chebvander(2 * x / _SPAN, _ORDER)
            given = w * (value[i:j] - mean[b - 1]) / of.contrast
            small = ridge if abs(middle) > 0.75 * reach else 5e-8
            found = np.linalg.solve(design.T @ design + small * np.eye(_ORDER + 1), design.T @ given)
            mean[b] = (found[0] - found[2] + found[4] - found[6]) * of.contrast + mean[b - 1]
            there[b] = True
        else:
            begin = reach + 3 / PER_PIXEL
            span = np.interp(abs(middle), [begin, 2 * reach, 2.25 * reach], [0.24, 1.0, 1.5])
            i, j = np.searchsorted(distance, [middle - span, middle + span])
            mean[b] = value[i:j].mean() if j > i else mean[b - 1]
            there[b] = j > i or there[b - 1]
    there[: max(of.left - 1, 0)] = there[of.right + 2 :] = False
    return _padded(mean, there, of), of


def _padded(mean, there, of):
    """The response with levels beyond its ends, and its tails smoothed by the noise."""
    used = np.flatnonzero(there)
    some = 8 if of.over_noise > 500 else 24
    response = np.interp(np.arange(SIZE), used, mean[used])
    for end, step, level in ((used[0], 1, mean[used[:some]].mean()), (used[-1], -1, mean[used[-some:]].mean())):
        for k in range(5):
            share = (k + 1) / 5
            response[end + step * k] = share * response[end + step * k] + (1 - share) * level
        response[slice(0, end) if step > 0 else slice(end + 1, SIZE)] = level
    left, right = max(of.left + 4, MIDDLE - 2 * of.half), min(of.right - 5, MIDDLE + 2 * of.half)
    response = _averaged_tails(response, left, right, round(_by(_TAILS, of.over_noise)))
    for table, factor, inset in ((_FEET, 1.25, 2), (_CORE, 0.75, 0)):
        near_left = int(max(of.left + inset, MIDDLE - factor * of.half))
        near_right = int(min(of.right - 1 - inset, MIDDLE + factor * of.half))
        width = min(round(_by(table, of.over_noise)), 8)
        if width:
            taps = np.exp(np.log(0.5) * (np.arange(-width, width + 1) / width) ** 2)
            smooth = np.convolve(np.pad(response, width, mode="edge"), taps / taps.sum(), "valid")
            for part in (slice(left - 4, near_left + 1), slice(near_right, right + 5)):
                response[part] = smooth[part]
        left, right = near_left + 2, near_right - 2
    return response


def _averaged_tails(response, left, right, width):
    """Beyond both places the mean of 2 width + 1 samples, joined without a step."""
    if left - 1 <= 0 or right >= SIZE - 2:
        return response
    mean = np.convolve(np.pad(response, width, mode="edge"), np.ones(2 * width + 1) / (2 * width + 1), "valid")
    result = response.copy()
    result[:left] = mean[:left] + (response[left] - mean[left])
    result[right:] = mean[right:] + (response[right] - mean[right])
    return result


# ---------------------------------------------------------------- transfer


def _smoothed_transfer(spectrum):
    """Modulus with its sign where it passes through zero, ever more smoothed, and its modulus again."""
    size = np.abs(spectrum) / abs(spectrum[0])
    turned = np.unwrap(np.angle(spectrum * np.exp(2j * np.pi * np.arange(spectrum.size) * MIDDLE / SIZE)))
    sign, last, signs = 1.0, -1, np.ones_like(size)
    for i in range(4, size.size - 1):
        if abs(turned[i] - turned[i - 2]) > np.pi / 2 and last < i - 1 and size[i] < 0.5:
            sign, last = -sign, i
        signs[i] = sign
    size = size * signs
    count = size.size - 8

    def pass_of(values, half, part):
        """Savitzky and Golay's filter of order 2."""
        x = np.arange(-half, half + 1)
        taps = np.linalg.pinv(np.vander(x, 3))[2]
        mirrored = np.concatenate([values[half:0:-1], values])
        return np.array([mirrored[i : i + 2 * half + 1] @ taps for i in part])

    size[:count] = pass_of(size, 2, range(count))
    for _ in range(3):
        smooth = size.copy()
        for half in range(2, 8):
            part = [i for i in range(7, count) if 2 + min(5, (i - 5) // 3) == half]
            smooth[part] = pass_of(size, half, part)
        size = smooth / smooth[0]
    return np.abs(size)


def transfer(picture):
    """Frequencies, cycles/px, and MTF of a picture of one edge."""
    picture = np.asarray(picture, float)
    y, x = np.indices(picture.shape)
    points, value = np.stack([x.ravel(), y.ravel()], -1).astype(float), picture.ravel()
    steep = _gradient(picture).ravel()
    centre, normal = _refined_line(points, steep)
    near = (np.abs((points - centre) @ normal) < 12) & ~_spoilt(points, steep, centre, normal)
    ridge_from = points[near], steep[near]
    centre, normal = _refined_line(*ridge_from)
    distance = _distances(points, _ridge(*ridge_from, centre, normal), centre, normal)
    used = np.abs(distance) < REACH
    order = np.argsort(distance[used])
    response, of = _response(distance[used][order], value[used][order])
    line = np.zeros(SIZE)
    line[of.left + 2 : of.right - 3] = (response[2:] - response[:-2])[of.left + 1 : of.right - 4]
    spectrum = np.fft.rfft(line)[: SIZE // 4]
    frequency = np.arange(spectrum.size) * PER_PIXEL / SIZE
    # a difference over two samples is a derivative through a box of two
    return frequency, _smoothed_transfer(spectrum) / np.sinc(2 * frequency / PER_PIXEL)


def mtf50(picture):
    """MTF50 of a picture of one edge, cycles/px; NaN where it finds none."""
    frequency, mtf = transfer(picture)
    below = np.flatnonzero((mtf[1:64] <= 0.5) & (mtf[:63] > 0.5))
    if not below.size:
        return np.nan
    k = int(below[0]) + 1
    step = frequency[1]
    plain = frequency[k - 1] + step * (mtf[k - 1] - 0.5) / (mtf[k - 1] - mtf[k])
    if not 5 <= k < 54:
        return plain
    half = min(max(2, k - 9), 9)
    at = np.arange(-half, half + 1)
    fitted = np.linalg.lstsq(np.vander(mtf[k + at], 3), at, rcond=None)[0] @ [0.25, 0.5, 1.0]
    better = (k + fitted) * step
    return better if k > 9 else plain + (k - 5) / SIZE / 8 * (better - plain)
