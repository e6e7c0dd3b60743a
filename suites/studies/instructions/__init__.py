"""How many instructions fixed pieces of kernel work take, counted by valgrind."""
