"""An ATI Net F/T on a network socket."""
