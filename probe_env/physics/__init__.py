"""The cable in the tube: scenes enter, displacements, forces and statistics leave; it knows no reward, no gymnasium.

From the bottom: the model (chain, drive, state); the methods, one of which advances a simulator; one simulator or many
and what is said of a run; the closed forms. Imports scenes, settings, arrays, errors, files and the machine's cores.
"""
