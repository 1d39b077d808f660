"""How a fleet is simulated: the record of a block, the order of events, and Python's face of both."""
