"""How safe a policy is: lost episodes counted by the ten thousand, the mildest sea that loses it, what guards save."""
