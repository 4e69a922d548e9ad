"""What the sensor shows and what is found: motion of the sensor enters, signals, signal-to-noise and detection leave.

Equations, conventions and assumptions: docs/inspection/signal.md. Imports settings and arrays; knows no simulator.
"""
