"""One picture a component, drawn from the code itself on a small scene."""
