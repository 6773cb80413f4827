"""The tools of the package: name -> (the folder of its module, what it is for)."""
TOOLS = {
    'configure': ('cli', 'write the params file of a vehicle from a recording of a drive'),
    'fusion_node': ('nodes', 'fuse IMU and GNSS live on ROS 2 topics'),
    'replay_node': ('nodes', 'run recordings through the same filter and measure its position error'),
    'play': ('nodes', 'publish a recording on its topics, with /clock'),
    'characterize': ('cli', 'sensor error parameters from a recording of the IMU at rest'),
    'diagnose': ('cli', 'find what the model lacks in a recording, and add it'),
    'compare': ('cli', 'two replays, params files or recordings side by side'),
    'fleet': ('cli', 'many recordings of many vehicles: tables, what changed in which vehicle, a check for CI'),
    'bench': ('cli', "any filter's output measured as a replay is, and recordings with outages for them"),
    'simulate': ('cli', 'write a recording of a simulated drive, with the truth'),
    'import_csv': ('cli', 'turn CSV files into a recording'),
    'compile': ('cli', 'compile the filter ahead: the first start of a tool waits for it otherwise'),
    'completion': ('cli', 'a script that completes tools, options and parameters in bash and zsh'),
}
