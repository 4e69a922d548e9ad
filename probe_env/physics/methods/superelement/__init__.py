"""The superelement methods: pieces of cable condensed to their floats and a few modes."""
