"""Method stratosplat: few aerial photos, completed by layered memory and neural planes."""
