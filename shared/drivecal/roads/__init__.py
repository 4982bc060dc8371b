"""Roads of SUMO networks and OpenDRIVE files: a route's lanes along one smooth reference line. See `roads.md`.

`network`: a `.net.xml`; `corridor`: the lanes of a route in Frenet coordinates; `conversion`: OpenDRIVE by netconvert.
"""
