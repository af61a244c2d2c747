"""Functions for a child process: each ends differently."""

import importlib
import os
import signal
import sys
import threading

from virtual_sensor.errors import InputError


def joined(*words):
    return " ".join(words)


def abort():
    os.kill(os.getpid(), signal.SIGABRT)


def leave():
    os._exit(3)


def allocate_without_end():
    kept = []
    while True:
        kept.append(bytearray(50_000_000))


def claim_memory():
    return bytearray(10**15)


def refuse():
    raise InputError("a.vtk: holds no points; export it again")


def fail():
    return {}["absent"]


def unpicklable():
    return lambda: None


def chatter():
    print("printed by Python")
    os.write(1, b"printed by C\n")
    os.write(2, b"complained by C\n")
    return os.read(0, 1)


def count(*, report):
    for i in range(3):
        report("counting", i)
    return "done"


def hang():
    threading.Event().wait()


def report_and_hang(*, report):
    report(os.getpid())
    threading.Event().wait()


def large(size):
    return b"x" * size


def pixels_and_radiance(scene):
    """What is searched and what is rendered of a scene."""
    import virtual_sensor as vs

    return vs.ray_search(scene, [0.0, -4.0], "newton").pixel, vs.render(scene)


def variant_and_radiance(scene):
    """Mitsuba's variant where a scene is unpickled, and what is rendered of it there."""
    import virtual_sensor as vs
    from virtual_sensor.engine import mi

    return mi.variant(), vs.render(scene)


def knew_zipapp():
    """Whether a module, which is imported while at work, was there before."""
    there = "zipapp" in sys.modules
    importlib.import_module("zipapp")
    return there


def knew_zipapp_and_fails():
    raise InputError(f"{knew_zipapp()}")


def report_and_answer(size, *, report):
    report(os.getpid())
    return b"x" * size


def import_what_takes_a_gigabyte():
    return len(importlib.import_module("takes_a_gigabyte").SPACE)
