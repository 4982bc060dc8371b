"""Roads of SUMO networks: reads a network, and follows a route's lanes along a smooth reference line.

`network`: a `.net.xml`; `corridor`: the lanes of a route in Frenet coordinates; `documents`: reads XML of strangers safely.
"""
