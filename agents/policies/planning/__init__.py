"""Controllers that look ahead: episodes that are running enter, actions leave; what feedback can win at best.

They try feed and air out on copies of the probes themselves, which no rig can. Imports the map, episodes and the task;
knows no file.
"""
