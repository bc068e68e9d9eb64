"""One working plugin of each kind, named mydevice, which ``eiwa plugins new`` copies under the name that is asked for."""
