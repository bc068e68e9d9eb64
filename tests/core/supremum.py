"""The true maximum per voxel, by routes that share nothing with the sampler.

For the paper's arm the tip depends on q1, q2, q3 alone and is inverted in closed form:
p = Rz(q1) (A cos q2, L2 sin q3, A sin q2) with A = L1 + L2 cos q3. The manipulability is h(q2, q3) |sin q5|, Eq. (1)'s
product is best with q4 and q6 at mid-range, so the best value at a tip is h g(m) with m the product over q1..q3 and
g(m) = max over q5 of |sin q5| (1 - exp(-K' m 4 u5 (1 - u5))), a function of one number that is tabulated.
"""

import numpy as np


class PaperArm:
    """Best Dex at points of the base frame, for limits +-half [rad] on all six joints."""

    def __init__(self, L1, L2, half, K):
        self.L1, self.L2, self.half = L1, L2, half
        self.K = K * 4.0**-6
        q5 = np.linspace(0, half, 4001)
        u5 = 0.5 + q5 / (2 * half)
        self.m = np.linspace(0, 1, 2001)
        self.g = np.max(np.abs(np.sin(q5)) * -np.expm1(-self.K * self.m[:, None] * 4 * u5 * (1 - u5)), axis=1)

    def best(self, p):
        """Largest w (1 - exp(...)) over the postures that reach each point p (n, 3); 0 where none does."""
        x, y, z = p.T
        cos3 = (x**2 + y**2 + z**2 - self.L1**2 - self.L2**2) / (2 * self.L1 * self.L2)
        reachable = np.abs(cos3) <= 1
        cos3 = np.clip(cos3, -1, 1)
        A = self.L1 + self.L2 * cos3
        with np.errstate(divide="ignore", invalid="ignore"):
            sin2 = np.where(A != 0, z / A, 2.0)
        reachable &= np.abs(sin2) <= 1
        sin2 = np.clip(sin2, -1, 1)
        best = np.zeros(len(p))
        for sign in (1, -1):
            q3 = sign * np.arccos(cos3)
            for q2 in (np.arcsin(sin2), np.pi - np.arcsin(sin2)):
                q2 = (q2 + np.pi) % (2 * np.pi) - np.pi
                q1 = np.arctan2(y, x) - np.arctan2(self.L2 * np.sin(q3), A * np.cos(q2))
                q1 = (q1 + np.pi) % (2 * np.pi) - np.pi
                u = 0.5 + np.stack([q1, q2, q3]) / (2 * self.half)
                inside = reachable & np.all((u >= 0) & (u <= 1), axis=0)
                m = np.prod(4 * u * (1 - u), axis=0)
                h = np.abs(self.L1 * self.L2 * np.cos(q2) * np.sin(q3) * A)
                value = h * np.interp(m, self.m, self.g)
                best = np.where(inside, np.maximum(best, value), best)
        return best

    def maximum(self):
        """Largest value anywhere (q1 at mid-range), on a fine grid of q2 and q3."""
        q = np.linspace(-self.half, self.half, 2401)
        u = 0.5 + q / (2 * self.half)
        b = 4 * u * (1 - u)
        h = np.abs(np.cos(q)[:, None] * self.L1 * self.L2 * np.sin(q) * (self.L1 + self.L2 * np.cos(q)))
        return float((h * np.interp(b[:, None] * b, self.m, self.g)).max())

    def cells(self, T_base_grid, lows, r, points=9):
        """Suprema over cubes with lower corners ``lows`` (n, 3) in a grid frame, from points^3 points each."""
        ticks = np.linspace(0, r, points)
        offsets = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
        best = np.zeros(len(lows))
        for offset in offsets:
            p = (lows + offset) @ T_base_grid[:3, :3].T + T_base_grid[:3, 3]
            best = np.maximum(best, self.best(p))
        return best
