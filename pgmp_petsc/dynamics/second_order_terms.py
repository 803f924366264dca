"""Terms of second order in the deformation of the reduced Lagrangian; `reduced_lagrangian` has the equations.

Each function adds its part to the residual and, if `fresh`, to the iteration matrix.
"""

from __future__ import annotations

from pgmp_petsc.runtime.vectors import (
    add,
    add_product,
    add_to_rows,
    dot,
    load,
    load_rows,
    polynomial,
    spread,
    store,
    zeros,
)
from pgmp_petsc.runtime.compiled import njit


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def add_cubic(layout, kept, place, fresh, work, matrix):
    """Add the terms of ``1/6 V delta delta delta``; `bent` becomes ``V delta``."""
    q, balance, bent = work.q, work.balance, work.bent
    r = len(place)
    m = layout.n_eta - r
    for entry in range(m * (m + 1) // 2):
        store(bent, entry, 0.0)
    energy = zeros(place)  # (d V) delta delta delta
    at = layout.cubic
    for i in range(m):
        q_i = load(q, r + i)
        row_i = i * (i + 1) // 2
        for j in range(i + 1):
            q_j = load(q, r + j)
            row_j = j * (j + 1) // 2
            part = zeros(place)
            own = load(bent, row_i + j)
            # entries with equal indices stand apart: they count once, others for each of their orders
            for k in range(j):
                value, slopes = polynomial(kept, at, place)
                q_k = load(q, r + k)
                own += value * q_k
                add(bent, row_i + k, value * q_j)
                if j < i:
                    add(bent, row_j + k, value * q_i)
                part = add_product(part, slopes, q_k)
                at += 1
            value, slopes = polynomial(kept, at, place)
            at += 1
            store(bent, row_i + j, own + value * q_j)
            if j < i:
                add(bent, row_j + j, value * q_i)
            product = q_i * q_j
            energy = add_product(energy, part, product * (6.0 if j < i else 3.0))
            energy = add_product(energy, slopes, product * q_j * (3.0 if j < i else 1.0))
    add_to_rows(balance, 0, 1, energy, spread(1.0 / 6.0))
    entry = 0
    for i in range(m):
        q_i, total = load(q, r + i), spread(0.0)
        for j in range(i):
            value = 0.5 * load(bent, entry + j)
            total += value * load(q, r + j)  # 1/2 (V delta) delta
            add(balance, r + j, value * q_i)
        add(balance, r + i, total + 0.5 * load(bent, entry + i) * q_i)
        entry += i + 1
    if fresh:
        for entry in range(m * (m + 1) // 2):
            add(matrix.factor, entry, load(bent, entry))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def add_bent_loads(layout, place, fresh, work, matrix):
    """Add the terms of ``- 1/2 a delta^T B delta``."""
    q, balance = work.q, work.balance
    r, n = len(place), layout.n_eta
    energy = zeros(place)  # a delta^T (d B) delta
    entry = n
    for i in range(n - r):
        q_i = load(q, r + i)
        for j in range(i + 1):
            value = load(work.load, entry)
            slopes = load_rows(work.load_slope, entry, layout.load_end, place)
            product = q_i * load(q, r + j)
            if j < i:
                product = product + product
                add(balance, r + j, -(value * q_i))  # - a B delta
            add(balance, r + i, -(value * load(q, r + j)))
            energy = add_product(energy, slopes, product)
            if fresh:
                add(matrix.factor, entry - n, -value)
            entry += 1
    add_to_rows(balance, 0, 1, energy, spread(-0.5))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def add_swing(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix):
    """Add the terms of ``- 1/2 sum_kl theta_k' theta_l' delta^T c_kl delta``, pair by pair (k >= j)."""
    q, v, a, balance, swung = work.q, work.v, work.a, work.balance, work.along
    r, n = len(place), layout.n_eta
    m = n - r
    at = layout.swing
    for k in range(r):
        for j in range(k + 1):
            both = 1.0 if j == k else 2.0
            v_k, v_j, a_k, a_j = load(v, k), load(v, j), load(a, k), load(a, j)
            turning = both * v_k * v_j
            energy = zeros(place)  # delta^T (d c) delta
            entry = 0
            for i in range(m):
                q_i, total = load(q, r + i), spread(0.0)
                for other in range(i + 1):
                    c, slopes = polynomial(kept, at, place)
                    q_j = load(q, r + other)
                    product = q_i * q_j
                    if other < i:
                        product = product + product
                        add(swung, other, c * q_i)
                    total += c * q_j
                    energy = add_product(energy, slopes, product)
                    if fresh:
                        add(matrix.factor, entry, turning * c)
                    at += 1
                    entry += 1
                store(swung, i, total)
            held, moving = spread(0.0), spread(0.0)  # delta^T c delta, delta'^T c delta
            for i in range(m):
                c = load(swung, i)
                held += load(q, r + i) * c
                moving += load(v, r + i) * c
                add(balance, r + i, turning * c)  # theta_k' theta_j' c delta
                if fresh:
                    add(matrix.column, k * m + i, 2.0 * gain_v * (v_j * c))
                    add(matrix.row, k * m + i, -2.0 * ((gain_v * v_j + a_j) * c))
                    if j < k:
                        add(matrix.column, j * m + i, 2.0 * gain_v * (v_k * c))
                        add(matrix.row, j * m + i, -2.0 * ((gain_v * v_k + a_k) * c))
            drift = dot(energy, velocity)
            add(balance, k, -(held * a_j + 2.0 * (moving * v_j) + drift * v_j))  # - (delta^T c delta theta_j')'
            if j < k:
                add(balance, j, -(held * a_k + 2.0 * (moving * v_k) + drift * v_k))
            add_to_rows(balance, 0, 1, energy, 0.5 * turning)
            if fresh:
                add(matrix.corner, k * r + j, -(gain_a * held + 2.0 * gain_v * moving))
                if j < k:
                    add(matrix.corner, j * r + k, -(gain_a * held + 2.0 * gain_v * moving))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def add_gyroscopic(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix):
    """Add the terms ``sum_k theta_k' (A_k delta').delta``, A_k skew."""
    q, v, a, balance, skewed, driven = work.q, work.v, work.a, work.balance, work.along, work.across
    r, n = len(place), layout.n_eta
    m = n - r
    at = layout.gyroscopic
    for k in range(r):
        v_k, a_k = load(v, k), load(a, k)
        changing = zeros(place)  # delta'.(d A_k) delta
        pushed = a_k + 2.0 * (gain_v * v_k)
        entry = 0
        for i in range(m):
            q_i, v_i = load(q, r + i), load(v, r + i)
            skew, drive = spread(0.0), spread(0.0)
            for j in range(i):
                value, slopes = polynomial(kept, at, place)
                q_j, v_j = load(q, r + j), load(v, r + j)
                # 2 A delta' + A' delta, with A' = sum_h theta_h' d_h A
                change = dot(slopes, velocity)
                skew += value * q_j
                drive += 2.0 * (value * v_j) + change * q_j
                add(skewed, j, -(value * q_i))
                add(driven, j, -(2.0 * (value * v_i) + change * q_i))
                changing = add_product(changing, slopes, v_i * q_j - v_j * q_i)
                if fresh:
                    before = load(matrix.skew, entry) if k > 0 else spread(0.0)
                    store(matrix.skew, entry, before - (value * pushed + v_k * change))
                at += 1
                entry += 1
            entry += 1
            store(skewed, i, skew)
            store(driven, i, drive)
        total = spread(0.0)
        for i in range(m):
            skew = load(skewed, i)
            # - theta_k'' A delta - theta_k' (2 A delta' + A' delta)
            add(balance, r + i, -(a_k * skew + v_k * load(driven, i)))
            total += load(a, r + i) * skew
            if fresh:
                add(matrix.column, k * m + i, -(gain_a * skew))
                add(matrix.row, k * m + i, -(gain_a * skew))
        add(balance, k, -(total + dot(changing, velocity)))  # - delta''.(A delta) - delta'.(A' delta)
        add_to_rows(balance, 0, 1, changing, v_k)  # theta_k' delta'.(d A_k) delta
