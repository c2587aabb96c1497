"""Grasping as pure controllers: (reading, state) -> (command, state or outcome).

In the order of a grasp: zero (pads unloaded) - descend (guarded) - close - confirm - lift - slip (through the
fold) - release - stuck (after it). None of them holds a clock: time is the readings' stamps, so that they are
the same in simulation, on hardware and in a test. A reading that is stale or no number ends each of them with
a typed failure; one that brings nothing new changes nothing.
"""
