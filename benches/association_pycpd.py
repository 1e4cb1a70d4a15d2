"""pycpd on the tracks that `cargo bench --bench association` left in $PEERS_DIR: one JSON line.

The same field (length 3, stiffness 3, in the sets' common scale), uniform weight and gate as ours; pycpd's own limits of
iterations. Only the registration is timed, not the assignment.
"""
import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import json
import statistics
import time

import numpy as np
from pycpd import DeformableRegistration
from scipy.optimize import linear_sum_assignment

rows = np.loadtxt(os.path.join(os.environ["PEERS_DIR"], "tracks.txt"))
(first, second), (mine, other) = ([rows[rows[:, 0] == s][:, 2:] for s in (0, 1)], [rows[rows[:, 0] == s][:, 1] for s in (0, 1)])
both = np.vstack([first, second])
centre, scale = both.mean(0), both.std(0).mean()
x, y = (second - centre) / scale, (first - centre) / scale
cpu = []
for _ in range(3):
    start = time.process_time()
    fit = DeformableRegistration(X=x, Y=y, alpha=3.0, beta=3.0, w=0.2)
    moved, _ = fit.register()
    cpu.append(time.process_time() - start)
distance = np.linalg.norm(moved[:, None] - x[None], axis=2) * scale
gate = 1000.0
i, j = linear_sum_assignment(np.minimum(distance**2, gate**2))
kept = distance[i, j] < gate
i, j = i[kept], j[kept]
right = np.sum((mine[i] == other[j]) & (mine[i] >= 0))
common = len(set(mine[mine >= 0]) & set(other[other >= 0]))
print(json.dumps(dict(peer="pycpd", size=len(rows), cpu_med=statistics.median(cpu), iterations=int(fit.iteration),
                      correct=right / common, false=1 - right / max(len(i), 1))))
