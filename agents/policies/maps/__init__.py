"""The vibration map: vibration over length, feed, air and tube, and the best schedules looked up in it."""
