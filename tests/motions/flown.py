"""Motions of fixed-wing aircraft, in the air and on the ground, and of a boat: random parameters.

The ranges are assumed: what such vehicles usually do, and somewhat more. Each docstring gives its ranges.
Wings fly coordinated: the force across the path is lift, so a turn banks by atan(V * rate / g), and the angle
of attack is that of the lift at this speed. Gusts push the vehicle without turning it, and an attitude jitter
of 0.1 to 2 deg is added. The wind has any direction; on the ground it is calm.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import rotation
from tests.motions.flown_paths import (
    FIGURES,
    SLOWEST,
    Figures,
    blend,
    box,
    coordinate,
    draw_course,
    draw_queue,
    draw_wind,
    drift_of,
    gusts,
    incidence,
    point,
    rock,
    steer,
    stroke,
    turn_by,
    turns,
)
from tests.motions.held import G, after, draw_log, jitter, smooth, waves
from tests.motions.truths import RATE, Kind, Motion, clock


def hand_launch(r: np.random.Generator) -> Motion:
    """Sway in a hand for 4 to 20 s, half of them walking, be thrown to 8 to 16 m/s in 0.3 to 0.8 s, turn.

    Hands sway by 0.5 to 4 deg and 2 to 15 cm/s and draw back before the throw; winds are 1 to 6 m/s.
    """
    held, push, thrown = r.uniform(4.0, 20.0), r.uniform(0.3, 0.8), r.uniform(8.0, 16.0)
    t = clock(held + r.uniform(90.0, 170.0))
    free, start, cruise = held + push, draw_course(r), max(9.0, thrown * r.uniform(0.8, 1.2))
    loose = after(t, free, r.uniform(3.0, 6.0))  # in the air and its wind
    (wind, wind_mps), gust = draw_wind(r, 1.0, 6.0), draw_log(r, 0.2, 1.0)
    up, first, ends = np.deg2rad(r.uniform(12.0, 30.0)), np.deg2rad(r.uniform(2.0, 20.0)), r.uniform(8, 20)
    settle = after(t, free + ends, 4.0)
    speed = thrown * 0.5 * (1.0 - np.cos(np.pi * np.clip((t - held) / push, 0.0, 1.0)))
    speed = speed + (cruise - thrown + 0.04 * cruise * waves(r, t, 30.0, 6.0)) * loose
    course = turn_by(start, turns(r, t, free + r.uniform(4.0, 10.0), 10.0, 40.0), speed)
    climb = first + (up - first) * after(t, free, r.uniform(0.8, 2.0))
    climb = climb * (1.0 - settle) + 0.05 * waves(r, t, 40.0, 8.0) * settle
    sway_deg, sway = draw_log(r, 0.5, 4.0), draw_log(r, 0.02, 0.15)
    hand = (
        sway
        * np.column_stack([waves(r, t, 6.0, 0.8) for _ in range(3)])
        * (1.0 - after(t, held, push))[:, None]
    )
    stop = held - r.uniform(1.0, 2.0)
    walk = r.uniform(0.5, 1.5) * (r.uniform() < 0.5) * (1.0 - after(t, stop - 1.5, 1.5))
    back = r.uniform(0.5, 1.5) * after(t, held - 0.8, 0.4) * (1.0 - after(t, held - 0.4, 0.4))
    step = 0.2 * walk * np.sin(2.0 * np.pi * r.uniform(1.6, 2.1) * t)
    hand = hand + (walk - back)[:, None] * point(course, 0.0 * t) + np.outer(step, [0.0, 0.0, 1.0])
    drift = loose[:, None] * wind
    vel_n = speed[:, None] * point(course, climb) + drift + hand + gusts(r, t, gust) * loose[:, None]
    tilt, nose_up = np.deg2rad(r.uniform(-20.0, 20.0)), np.deg2rad(r.uniform(-10.0, 30.0))
    aim = after(t, held - 1.0, 0.9)  # it is held level and up for the throw
    rest = np.column_stack([tilt * (1.0 - aim), nose_up + (first - nose_up) * aim, course])
    rest = rest + jitter(r, 0.4 * t, sway_deg)
    noise = draw_log(r, 0.3, 2.0)
    euler = coordinate(course, climb, speed, drift, cruise, r.uniform(4.0, 7.0))
    euler = blend(after(t, held + 0.5 * push, 1.0), rest, euler + jitter(r, t, noise))
    figures = {"held_s": held, "push_s": push, "thrown_mps": thrown, "wind_mps": wind_mps}
    return Motion(
        vel_n, euler, (), 0.0, 1.0, figures | {"cruise_mps": cruise, "gust_mps": gust, "sway_deg": sway_deg}
    )


def catapult(r: np.random.Generator) -> Motion:
    """Rest on a rail, level or up by 5 to 15 deg, for 15 to 40 s, leave it at 20 to 35 m/s with 3 to 8 g.

    Bungees and compressed air give about that (assumed). Then climb and turn.
    """
    rest, left = r.uniform(15.0, 40.0), r.uniform(20.0, 35.0)
    push = r.uniform(max(0.3, 4.0 * left / (24.0 * G)), min(1.0, 4.0 * left / (9.0 * G)))
    t = clock(rest + r.uniform(85.0, 170.0))
    free, start, cruise = rest + push, draw_course(r), left * r.uniform(0.8, 1.15)
    rail = np.deg2rad(r.uniform(5.0, 15.0)) * (r.uniform() < 0.6)
    (wind, wind_mps), gust = draw_wind(r, 1.0, 9.0), draw_log(r, 0.2, 1.2)
    loose, settle = after(t, free, r.uniform(4.0, 8.0)), after(t, free + r.uniform(10.0, 40.0), 6.0)
    up = np.deg2rad(r.uniform(6.0, 18.0))
    speed = left * stroke(t, rest, push) + (cruise - left + 0.04 * cruise * waves(r, t, 40.0, 8.0)) * loose
    course = turn_by(start, turns(r, t, free + r.uniform(5.0, 15.0), 10.0, 45.0), speed)
    climb = rail + (up - rail) * after(t, free + 0.1, r.uniform(2.0, 4.0))
    climb = climb * (1.0 - settle) + 0.04 * waves(r, t, 40.0, 10.0) * settle
    drift = loose[:, None] * wind
    vel_n = speed[:, None] * point(course, climb) + drift + gusts(r, t, gust) * loose[:, None]
    cradle = np.deg2rad([r.uniform(-3.0, 3.0), r.uniform(0.0, 5.0), r.uniform(-1.0, 1.0)])
    shake = jitter(r, t, draw_log(r, 0.05, 0.4)) * (after(t, rest, 0.2))[:, None]
    on_rail = np.column_stack([0.0 * t, 0.0 * t + rail, course]) + cradle + shake
    noise = draw_log(r, 0.2, 1.5)
    euler = coordinate(course, climb, speed, drift, cruise, r.uniform(3.0, 6.0)) + jitter(r, t, noise)
    euler = blend(after(t, free, r.uniform(0.6, 1.5)), on_rail, euler)
    figures = {
        "rest_s": rest,
        "push_g": 4.0 * left / (3.0 * G * push),
        "left_mps": left,
        "rail_deg": float(np.rad2deg(rail)),
    }
    return Motion(vel_n, euler, ("level",), rest, 1.0, figures | {"wind_mps": wind_mps, "gust_mps": gust})


def thermal(r: np.random.Generator) -> Motion:
    """Circle in thermals that drift with 1 to 8 m/s, 18 to 35 m/s and 20 to 50 deg of bank, and glide on.

    Thermals carry by 1 to 5 m/s, more on one side of the circle; a glider sinks at 1 in 20 to 1 in 40.
    """
    t, speed_mps, start = clock(r.uniform(110.0, 240.0)), draw_log(r, 18.0, 35.0), draw_course(r)
    (wind, wind_mps), gust = draw_wind(r, 1.0, 8.0), draw_log(r, 0.2, 1.0)
    bank, inside, now, first = np.zeros(len(t)), np.zeros(len(t)), 0.0, 0.0
    while now < t[-1]:
        end = now + r.uniform(40.0, 90.0)
        tight = r.choice([-1.0, 1.0]) * r.uniform(20.0, 50.0)
        first = first or abs(tight)
        bank += np.deg2rad(tight) * box(t, now, end)
        inside += box(t, now, end)
        now = end + r.uniform(12.0, 35.0)
    wobble = np.deg2rad(draw_log(r, 1.0, 5.0)) * waves(r, t, 12.0, 2.0)
    bank, inside = smooth(bank, 4.0) + wobble, smooth(inside, 6.0)
    speed = speed_mps * (1.0 + r.uniform(0.1, 0.4) * (1.0 - inside) + 0.03 * waves(r, t, 30.0, 6.0))
    course = turn_by(start, bank, speed)
    climb = -1.0 / r.uniform(20.0, 40.0) + 0.02 * waves(r, t, 30.0, 6.0)
    lift = r.uniform(1.0, 5.0) * (1.0 + r.uniform(0.0, 0.5) * np.sin(course + draw_course(r))) * inside
    drift = np.broadcast_to(wind, (len(t), 3)) - np.outer(smooth(lift, 2.0), [0.0, 0.0, 1.0])
    vel_n = speed[:, None] * point(course, climb) + drift + gusts(r, t, gust)
    noise = draw_log(r, 0.3, 2.0)
    euler = coordinate(course, climb, speed, drift, speed_mps, r.uniform(4.0, 7.0)) + jitter(
        r, 0.6 * t, noise
    )
    figures = {
        "speed_mps": speed_mps,
        "wind_mps": wind_mps,
        "gust_mps": gust,
        "bank_deg": first,
        "jitter_deg": noise,
    }
    return Motion(vel_n, euler, ("course",), 0.0, drift_of(wind_mps, speed_mps, gust, 2.0 + noise), figures)


def aerobatic_figure(r: np.random.Generator) -> Motion:
    """Run in straight for 21 to 35 s at 18 to 60 m/s, models and full size, then fly figures.

    Loops are pulled with 3.5 to 5.5 g, rolls take 90 to 270 deg/s; the engine holds 40 to 70 % of the weight.
    """
    cruise, load, roll_rate = (
        draw_log(r, 18.0, 60.0),
        r.uniform(3.5, 5.5),
        np.deg2rad(draw_log(r, 90.0, 270.0)),
    )
    seconds, path = (
        r.uniform(100.0, 190.0),
        Figures(draw_course(r), cruise, load, roll_rate, r.uniform(0.4, 0.7)),
    )
    path.line(r.uniform(21.0, 35.0))
    flown = 0
    while len(path.speed) < seconds * RATE:
        path.fly(str(r.choice(FIGURES)), r.choice([-1.0, 1.0]), r.choice([0.0, -90.0, 90.0]))
        path.line(r.uniform(2.0, 7.0))
        flown += 1
    q, speed = rotation.continuous(np.concatenate(path.q)), np.array(path.speed)
    t = np.arange(len(q)) / RATE
    (wind, wind_mps), gust = draw_wind(r, 0.5, 6.0), draw_log(r, 0.1, 0.8)
    air = speed[:, None] * rotation.rotate(q, [1.0, 0.0, 0.0])
    force = rotation.rotate(
        rotation.conjugate(q), np.gradient(air, 1.0 / RATE, axis=0, edge_order=2) - [0.0, 0.0, G]
    )
    trim_deg, zero = r.uniform(2.0, 4.0), 0.0 * t
    up = incidence(smooth(-force[:, 2], 0.3) / G, speed, cruise, trim_deg)
    side = incidence(smooth(force[:, 1], 0.3) / G, speed, cruise, 1.5 * trim_deg)
    q = rotation.multiply(q, rotation.from_rotvec(np.column_stack([zero, zero, side])))
    q = rotation.multiply(q, rotation.from_rotvec(np.column_stack([zero, up, zero])))
    noise = draw_log(r, 0.2, 1.5)
    q = rotation.multiply(q, rotation.from_rotvec(jitter(r, t, noise)))
    euler = np.column_stack(rotation.to_euler(q))
    figures = {
        "speed_mps": cruise,
        "load_g": load,
        "roll_degps": float(np.rad2deg(roll_rate)),
        "wind_mps": wind_mps,
    }
    drift_deg = drift_of(wind_mps, cruise, gust, noise)
    figures |= {"gust_mps": gust, "figures_flown": float(flown)}
    return Motion(air + wind + gusts(r, t, gust), euler, ("course",), 0.0, drift_deg, figures)


def reversal(r: np.random.Generator) -> Motion:
    """Fly straight at 15 to 250 m/s, models to airliners, turn level by 180 deg, and back, up to three times.

    Banks are 15 to 60 deg, at least as steep as a turn of 120 s takes; winds are 2 to 25 % of the airspeed.
    """
    cruise, start, soft = draw_log(r, 15.0, 250.0), draw_course(r), r.uniform(2.0, 6.0)
    bank = np.arctan(max(np.tan(np.deg2rad(draw_log(r, 15.0, 60.0))), np.pi * cruise / (G * 120.0)))
    turn_s = np.pi * cruise / (G * np.tan(bank))
    marks: list[tuple[float, float]] = []
    now = r.uniform(22.0, 60.0)
    for _ in range(int(r.integers(1, 4))):
        if not marks or now + turn_s + 20.0 < 235.0:
            marks.append((now, r.choice([-1.0, 1.0])))
            now += turn_s + r.uniform(15.0, 45.0)
    t = clock(min(240.0, max(now + 5.0, 100.0)))
    rate = np.zeros(len(t))
    for begin, side in marks:
        one = smooth(box(t, begin, begin + turn_s), soft)
        rate += side * np.pi * one / (one.sum() / RATE)
    course = start + np.cumsum(rate) / RATE + 0.01 * waves(r, t, 60.0, 15.0)
    speed = cruise * (1.0 + r.uniform(0.005, 0.04) * waves(r, t, 60.0, 15.0))
    climb = min(0.03, 0.6 / cruise) * waves(r, t, 60.0, 15.0)
    (wind, wind_mps), gust = draw_wind(r, 0.02 * cruise, 0.25 * cruise), draw_log(r, 0.1, 1.2)
    drift = np.broadcast_to(wind, (len(t), 3))
    vel_n = speed[:, None] * point(course, climb) + drift + gusts(r, t, gust)
    noise = draw_log(r, 0.1, 1.0)
    euler = coordinate(course, climb, speed, drift, cruise, r.uniform(2.0, 5.0)) + jitter(
        r, min(1.0, 20.0 / cruise) ** 0.5 * t, noise
    )
    figures = {
        "speed_mps": cruise,
        "wind_mps": wind_mps,
        "gust_mps": gust,
        "bank_deg": float(np.rad2deg(bank)),
    }
    figures |= {"turn_s": turn_s, "reversals": float(len(marks))}
    return Motion(vel_n, euler, ("course",), 0.0, drift_of(wind_mps, cruise, gust, noise + 0.3), figures)


def tow(r: np.random.Generator) -> Motion:
    """Rest on the ground for 15 to 40 s, be towed to 25 to 35 m/s over bumps in 12 to 25 s, climb, let go.

    Behind the tug it swings by 1 to 6 deg of course in 8 to 20 s. It climbs by 3 to 7 deg and, free, glides.
    """
    rest, roll_s, cruise, start = (
        r.uniform(15.0, 40.0),
        r.uniform(12.0, 25.0),
        r.uniform(25.0, 35.0),
        draw_course(r),
    )
    lift_off, released = rest + 0.65 * roll_s, rest + roll_s + r.uniform(40.0, 80.0)
    t = clock(released + r.uniform(40.0, 80.0))
    loose, aloft, free = after(t, lift_off, 6.0), after(t, lift_off, 2.0), after(t, released, 3.0)
    (wind, wind_mps), gust = draw_wind(r, 1.0, 8.0), draw_log(r, 0.2, 1.0)
    rope = r.uniform(0.1, 0.4) * waves(r, t, 6.0, 1.5) * aloft * (1.0 - free)
    speed = cruise * after(t, rest, roll_s) - r.uniform(0.0, 4.0) * free + rope
    behind = turns(r, t, lift_off + 12.0, 5.0, 20.0) * (1.0 - free)
    away = r.choice([-1.0, 1.0]) * smooth(box(t, released + 1.0, released + r.uniform(6.0, 12.0)), 3.0)
    bank = behind + np.deg2rad(r.uniform(25.0, 45.0)) * away + turns(r, t, released + 15.0, 10.0, 40.0)
    swing_deg = draw_log(r, 1.0, 6.0)
    swing = (
        np.deg2rad(swing_deg)
        * waves(r, t, 20.0, 8.0)
        * after(t, lift_off + 3.0, 8.0)
        * (1.0 - after(t, released, 6.0))
    )
    course = turn_by(start, bank, speed) + swing
    up, down = np.deg2rad(r.uniform(3.0, 7.0)), 1.0 / r.uniform(20.0, 40.0)
    climb = up * after(t, lift_off, 8.0) - (up + down) * free + 0.015 * waves(r, t, 15.0, 5.0) * loose
    rolls = np.minimum(speed / 5.0, 1.0) * (1.0 - aloft)
    bump = draw_log(r, 0.03, 0.15)
    drift = loose[:, None] * wind
    vel_n = speed[:, None] * point(course, climb) + drift + gusts(r, t, gust) * loose[:, None]
    vel_n[:, 2] += bump * waves(r, t, 1.2, 0.25, 6) * rolls
    stance = np.deg2rad([r.uniform(-3.0, 3.0), r.uniform(0.0, 6.0), r.uniform(-1.0, 1.0)])
    ground = (
        np.column_stack([0.0 * t, 0.0 * t, course]) + stance + jitter(r, 0.5 * t, 5.0 * bump) * rolls[:, None]
    )
    noise = draw_log(r, 0.3, 1.5)
    euler = coordinate(course, climb, speed, drift, cruise, r.uniform(4.0, 7.0)) + jitter(r, 0.6 * t, noise)
    euler = blend(after(t, lift_off - 2.0, 4.0), ground, euler)
    figures = {"rest_s": rest, "speed_mps": cruise, "wind_mps": wind_mps, "gust_mps": gust, "bump_mps": bump}
    figures |= {"swing_deg": swing_deg, "released_s": released}
    return Motion(vel_n, euler, ("level",), rest, 1.0, figures)


def small_plane_in_wind(r: np.random.Generator) -> Motion:
    """Fly circuits and orbits at 12 to 18 m/s through the air, in a wind of 4 to 11 m/s with gusts.

    The nose points off the course by up to 66 deg, and against the wind it hardly moves over the ground.
    """
    t, airspeed, start = clock(r.uniform(100.0, 200.0)), r.uniform(12.0, 18.0), draw_course(r)
    (wind, wind_mps), gust = draw_wind(r, 4.0, 11.0), draw_log(r, 0.2, 1.2)
    course = steer(r, t, start, airspeed, wind)
    speed = airspeed * (1.0 + 0.03 * waves(r, t, 30.0, 6.0))
    climb = r.uniform(0.02, 0.08) * waves(r, t, 40.0, 8.0)
    drift = np.broadcast_to(wind, (len(t), 3))
    vel_n = speed[:, None] * point(course, climb) + drift + gusts(r, t, gust)
    noise = draw_log(r, 0.4, 2.0)
    euler = coordinate(course, climb, speed, drift, airspeed, r.uniform(4.0, 7.0)) + jitter(r, t, noise)
    slowest = float(np.hypot(*vel_n[: round(20.0 * RATE) + 1, :2].T).min())
    starts = ("course",) if slowest > SLOWEST else ()
    figures = {"airspeed_mps": airspeed, "wind_mps": wind_mps, "gust_mps": gust, "slowest_start_mps": slowest}
    return Motion(vel_n, euler, starts, 0.0, drift_of(wind_mps, airspeed, gust, noise), figures)


def aircraft_queue(r: np.random.Generator) -> Motion:
    """Rest for 12 to 40 s, move up in a queue of 3 to 8 stops of 5 to 40 s, line up, take off and turn.

    Moves are 5 to 60 m at up to 8 m/s. Braking dips the nose by 0.3 to 1.5 deg for 1 m/s^2, and it rocks at
    0.7 to 1.4 Hz with a damping of 0.1 to 0.3. Taxiways slope by up to 1.5 deg and bend by 3 to 15 deg.
    """
    rest, start = r.uniform(12.0, 40.0), draw_course(r)
    moves, begins = draw_queue(r, rest)
    fast, hard = r.uniform(30.0, 70.0), r.uniform(1.5, 3.0)
    run = fast / hard
    lift_off = begins + 0.6 * run
    t = clock(min(240.0, max(lift_off + r.uniform(40.0, 60.0), 90.0)))
    taxi = np.zeros(len(t))
    for begin, peak, ramp, steady in moves:
        taxi += peak * after(t, begin, ramp) * (1.0 - after(t, begin + ramp + steady, ramp))
    way = np.cumsum(taxi) / RATE
    fast_part = after(t, begins, run)
    speed = taxi + fast * fast_part * (1.0 + 0.02 * waves(r, t, 40.0, 10.0) * after(t, begins + run, 8.0))
    bend_deg, slope_deg = draw_log(r, 3.0, 15.0), draw_log(r, 0.2, 1.0)
    line_up = 0.5 * np.pi * r.choice([-1.0, 1.0]) * after(way, way[-1] - 32.0, 30.0)
    taxiway = start + np.deg2rad(bend_deg) * waves(r, way, 200.0, 60.0, 2) + line_up
    slope = np.deg2rad(slope_deg) * np.clip(waves(r, way, 200.0, 50.0, 2), -1.5, 1.5)
    course = taxiway + turn_by(0.0, turns(r, t, lift_off + r.uniform(10.0, 18.0), 10.0, 28.0), speed)
    aloft, loose = after(t, lift_off + 1.0, 3.0), after(t, lift_off + 1.0, 8.0)
    climb = slope * (1.0 - aloft) + np.deg2rad(r.uniform(4.0, 10.0)) * after(t, lift_off + 1.0, 5.0)
    (wind, wind_mps), gust = draw_wind(r, 0.5, 8.0), draw_log(r, 0.2, 1.2)
    drift = loose[:, None] * wind
    vel_n = speed[:, None] * point(course, climb) + drift + gusts(r, t, gust) * loose[:, None]
    squat_deg, hertz = draw_log(r, 0.3, 1.5), draw_log(r, 0.7, 1.4)
    dip = np.deg2rad(squat_deg) * rock(np.gradient(speed) * RATE, hertz, r.uniform(0.1, 0.3))
    stance = np.deg2rad([r.uniform(-1.5, 1.5), r.uniform(-2.0, 4.0), r.uniform(-0.5, 0.5)])
    rough = jitter(r, t, draw_log(r, 0.03, 0.2)) * np.minimum(speed / 4.0, 1.0)[:, None]
    ground = np.column_stack([0.5 * slope, slope + dip, course]) + stance + rough
    noise = draw_log(r, 0.2, 1.0)
    euler = coordinate(course, climb, speed, drift, fast, r.uniform(5.0, 8.0)) + jitter(r, 0.6 * t, noise)
    euler = blend(after(t, lift_off - 1.5, 4.0), ground, euler)
    figures = {"rest_s": rest, "stops": float(len(moves)), "squat_deg": squat_deg, "speed_mps": fast}
    figures |= {"slope_deg": slope_deg, "wind_mps": wind_mps, "gust_mps": gust, "takeoff_s": begins}
    return Motion(vel_n, euler, ("level",), rest, 1.0, figures)


def moored_boat_then_sails(r: np.random.Generator) -> Motion:
    """Swing at a mooring for 40 to 90 s by 5 to 30 deg in 30 to 90 s, then leave at 2 to 8 m/s in a current.

    Waves of 2 to 8 s heave by 0.05 to 0.4 m, by a fiftieth of their length at most, and roll by 1 to 6 deg.
    """
    moored, period, speed_mps = r.uniform(40.0, 90.0), draw_log(r, 2.0, 8.0), draw_log(r, 2.0, 8.0)
    t = clock(moored + r.uniform(70.0, 140.0))
    start, leave = draw_course(r), r.uniform(6.0, 15.0)
    sails = after(t, moored, leave)
    swing_deg, swing_s, line = draw_log(r, 5.0, 30.0), draw_log(r, 30.0, 90.0), r.uniform(3.0, 8.0)
    swing = np.deg2rad(swing_deg) * np.sin(2.0 * np.pi * t / swing_s + draw_course(r))
    turn = np.deg2rad(draw_log(r, 1.5, 6.0)) * waves(r, t, 60.0, 12.0)
    turn = turn * after(t, moored + 5.0, 10.0)
    heading = start + swing * (1.0 - sails) + np.cumsum(turn) / RATE
    heave = min(draw_log(r, 0.05, 0.4), 0.02 * 1.56 * period**2)
    current, current_mps = draw_wind(r, 0.05, 0.8)
    leeway = np.deg2rad(r.uniform(-6.0, 6.0)) * sails
    speed = speed_mps * sails * (1.0 + 0.1 * waves(r, t, 40.0, 10.0))
    sea = [heave / np.sqrt(2.0) * waves(r, t, 1.2 * period, 0.85 * period) for _ in range(3)]
    surf = np.gradient(np.column_stack(sea), 1.0 / RATE, axis=0, edge_order=2) * [0.4, 0.4, 1.0]
    aside = (
        line * np.gradient(heading, edge_order=2) * RATE * (1.0 - sails)
    )  # the bow is held, and the rest swings about it
    vel_n = speed[:, None] * point(heading + leeway, 0.0 * t) + surf + sails[:, None] * current
    vel_n = vel_n + aside[:, None] * point(heading + 0.5 * np.pi, 0.0 * t)
    rock_deg = [draw_log(r, 1.0, 6.0), draw_log(r, 1.0, 4.0), 1.0]
    rolls = [np.deg2rad(a / np.sqrt(2.0)) * waves(r, t, 1.2 * period, 0.85 * period) for a in rock_deg]
    heel = np.deg2rad(r.uniform(-12.0, 12.0)) * sails - 0.5 * speed * turn / G
    euler = np.column_stack([rolls[0] + heel, rolls[1], heading + rolls[2]])
    figures = {"moored_s": moored, "wave_s": period, "heave_m": heave, "roll_deg": rock_deg[0]}
    figures |= {
        "swing_deg": swing_deg,
        "swing_s": swing_s,
        "speed_mps": speed_mps,
        "current_mps": current_mps,
    }
    return Motion(vel_n, euler, (), 0.0, 1.0, figures)


KINDS: dict[str, Kind] = {
    one.__name__.replace("_", " "): one
    for one in (
        hand_launch,
        catapult,
        thermal,
        aerobatic_figure,
        reversal,
        tow,
        small_plane_in_wind,
        aircraft_queue,
        moored_boat_then_sails,
    )
}
