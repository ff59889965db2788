"""The probing task: plan, sites, routes, runs and replay."""
