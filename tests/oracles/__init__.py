"""What tests compare with: chains with a closed form, a dense solution, orders from successive differences, scatter."""
