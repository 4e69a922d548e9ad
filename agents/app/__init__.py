"""The app: a page on this machine on which schedules are dragged, insertions watched and policies compared.

``runs`` plays and stores, ``forms`` is what is typed in, ``page`` is what is seen. Tubes, schedules and stored folders
enter and leave as the files that the commands take; physics, statistics and files are those of the other rooms. Imports
policies, rollouts, evaluation, designs and what is below them; Bokeh in ``page`` and ``server`` alone.
"""
