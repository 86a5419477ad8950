# The environment of wisar, for bash and zsh:   source env.sh
#
# Puts the `wisar` command and Python on PATH and makes the three packages known to ROS 2.
# The nodes start with `ros2 run wisar_planner planner` where ros2 is installed, and with
# $WISAR_PREFIX/lib/wisar_planner/planner everywhere.
# Discovery stays on this machine unless you set ROS_AUTOMATIC_DISCOVERY_RANGE yourself.

_wisar_root="$(cd "$(dirname "${BASH_SOURCE[0]:-${(%):-%x}}")" && pwd)"

_wisar_prepend() { # NAME DIRECTORY: put a directory in front of a path variable, and only there
  eval "_wisar_value=:\${$1:-}:"
  _wisar_entry=":$2:"
  _wisar_value=${_wisar_value//"$_wisar_entry"/:}
  _wisar_value=${_wisar_value#:}
  _wisar_value=${_wisar_value%:}
  export "$1=$2${_wisar_value:+:$_wisar_value}"
}

if [ ! -d "$_wisar_root/install" ]; then
  echo "env.sh: nothing is built yet, run: make -C $_wisar_root setup" >&2
else
  export WISAR_PREFIX="$_wisar_root/install"
  _wisar_site="$(echo "$WISAR_PREFIX"/lib/python3*/site-packages)"
  if [ -d "$_wisar_root/.venv/share/rcl_interfaces" ]; then
    # ROS 2 from wheels: their bootstrap would start Python a second time to set this.
    export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
    for _wisar_libs in "$_wisar_root"/.venv/lib/python3*/site-packages/ros_*.libs; do
      [ -d "$_wisar_libs" ] && _wisar_prepend LD_LIBRARY_PATH "$_wisar_libs"
    done
    _wisar_prepend LD_LIBRARY_PATH "$_wisar_root/.venv/lib"
    _wisar_prepend AMENT_PREFIX_PATH "$_wisar_root/.venv"
    export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3
  fi
  _wisar_prepend LD_LIBRARY_PATH "$WISAR_PREFIX/lib"
  _wisar_prepend AMENT_PREFIX_PATH "$WISAR_PREFIX"
  _wisar_prepend PYTHONPATH "$_wisar_site"
  _wisar_prepend PATH "$_wisar_root/.venv/bin"
  export NUMBA_CACHE_DIR="$_wisar_root/.cache/numba"
  export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
fi
unset -f _wisar_prepend
unset _wisar_root _wisar_value _wisar_entry _wisar_site _wisar_libs
