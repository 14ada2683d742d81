"""Behind the catalyst: bank of stores and downstream sensors, their rule, circuit and activity."""
