"""Grasping as pure controllers: (reading, state) -> (command, state or outcome).

A grasp runs them in this order: tare (pads unloaded), descend (guarded), close, confirm, lift, slip (during the
whole fold), release, stuck_on_finger. The controllers have no clock: time comes from the stamps of the readings.
They therefore behave the same in simulation, on hardware and in tests. A stale or non-finite reading ends any of
them with a typed failure. A reading without new data changes nothing.
"""
