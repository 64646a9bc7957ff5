#!/bin/sh
# Runs both campaigns and prints their tables; a scan's CPU time is without the start.
set -e
for name in slam sim; do
  [ -f data/benchmarks/peers/$name/manifest.json ] ||
    turtlebag sweep benchmarks/peers/$name.yaml --allow-commands --out data/benchmarks/peers/$name
done
turtlebag sweep data/benchmarks/peers/slam --query "
  SELECT w.world, w.system, round(1000 * median(w.ate_aligned_m), 1) AS aligned_mm,
    round(100 * median(w.drift), 2) AS drift_cm_m, round(1000 * median((w.cpu_s - s.cpu_s) / (w.poses - s.poses)), 2) AS scan_ms,
    round(median(s.cpu_s), 2) AS start_cpu_s, round(median(s.wall_s), 2) AS start_wall_s, round(max(w.memory_mb)) AS memory_mb
  FROM runs w JOIN runs s USING (world, seed, system) WHERE w.part = 'whole' AND s.part = 'start'
  GROUP BY ALL ORDER BY w.world, aligned_mm"
turtlebag sweep data/benchmarks/peers/sim --query "
  SELECT w.system, round(60 / (min(w.cpu_s) - min(s.cpu_s)), 1) AS x_real_time, round(min(s.cpu_s), 2) AS start_cpu_s,
    round(max(w.memory_mb)) AS memory_mb
  FROM runs w JOIN runs s USING (seed, system) WHERE w.seconds = 65 AND s.seconds = 5 GROUP BY ALL ORDER BY w.system"
