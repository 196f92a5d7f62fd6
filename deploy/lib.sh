# Shared by deploy/run and deploy/test: what this machine lacks, and how it gets it. Bash, sourced, never run.
#
# needs_* functions look and never install; each that finds something missing adds to `missing_packages` (what
# apt-get is to install) and `missing_reasons` (why). install_missing does the rest.
# shellcheck shell=bash

# Debian keeps ldconfig where the PATH of ordinary users does not look.
PATH="$PATH:/usr/sbin:/sbin"
# rustup's folder, for shells that have not read its profile.
if ! command -v cargo >/dev/null && [[ -x "${CARGO_HOME:-${HOME:-/root}/.cargo}/bin/cargo" ]]; then
    PATH="${CARGO_HOME:-${HOME:-/root}/.cargo}/bin:$PATH"
fi

repository="$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)"
missing_packages=()
missing_reasons=()

say() {
    printf '%s: %s\n' "${program:-deploy}" "$*" >&2
}

die() {
    say "$*"
    exit 1
}

is_linux() {
    [[ "$(uname -s)" == Linux ]]
}

# need PACKAGES REASON: notes what apt-get is to install (several packages separated by spaces).
need() {
    local packages
    read -r -a packages <<<"$1"
    missing_packages+=("${packages[@]}")
    missing_reasons+=("$1: $2")
}

# The oldest Rust that Cargo.toml allows.
rust_version_wanted() {
    sed -n 's/^rust-version *= *"\(.*\)"/\1/p' "$repository/Cargo.toml" | head -n 1
}

# Rust is not installed here: which toolchain, and from where, is its owner's choice.
check_rust() {
    local wanted found
    wanted="$(rust_version_wanted)"
    command -v cargo >/dev/null || die "Rust is missing (cargo is not in PATH). Get it from https://rustup.rs, at least $wanted."
    found="$(cd "$repository" && rustc --version | sed 's/^rustc \([0-9.]*\).*/\1/')"
    if [[ "$(printf '%s\n%s\n' "$wanted" "$found" | sort -V | head -n 1)" != "$wanted" ]]; then
        die "Rust $found is too old, $wanted is needed. With rustup: rustup update stable"
    fi
}

# Rust links with the C compiler; C headers come with it.
needs_linker() {
    command -v cc >/dev/null || need "gcc libc6-dev" "a C compiler, with which Rust links programs"
}

# The picture comparison (FLIP, for `skycell-server measure`) is C++.
needs_cxx() {
    command -v c++ >/dev/null || need "g++" "a C++ compiler for the FLIP picture comparison"
}

# Whether install_missing could install something without asking anybody.
can_install() {
    command -v apt-get >/dev/null || return 1
    ((EUID == 0)) || { command -v sudo >/dev/null && { [[ -t 0 ]] || sudo -n true 2>/dev/null; }; }
}

# OpenH264 has its inner loops in assembler for x86, twice as fast as those that a C++ compiler makes. It builds without.
needs_nasm() {
    case "$(uname -m)" in
        x86_64 | i?86) ;;
        *) return 0 ;;
    esac
    command -v nasm >/dev/null && return 0
    if can_install; then
        need "nasm" "an assembler, with which the H.264 encoder is twice as fast"
    else
        say "no nasm: the H.264 encoder is built without its assembler and is half as fast"
    fi
}

has_vulkan_loader() {
    # Read whole before it is searched: with pipefail, a grep that stops early would count as a failure.
    local libraries file
    libraries="$(ldconfig -p 2>/dev/null || true)"
    [[ "$libraries" == *libvulkan.so.1* ]] && return 0
    for file in /usr/lib*/libvulkan.so.1 /usr/lib/*/libvulkan.so.1 /usr/local/lib*/libvulkan.so.1; do
        [[ -e "$file" ]] && return 0
    done
    # Where Nix and other package managers put it.
    local folders folder
    IFS=: read -r -a folders <<<"${LD_LIBRARY_PATH:-}"
    for folder in "${folders[@]}"; do
        [[ -n "$folder" && -e "$folder/libvulkan.so.1" ]] && return 0
    done
    return 1
}

# Prints the files that tell the loader of drivers (ICDs), in the places where it looks.
vulkan_driver_files() {
    local configuration="${XDG_CONFIG_HOME:-${HOME:-/root}/.config}:${XDG_CONFIG_DIRS:-/etc/xdg}"
    local data="${XDG_DATA_HOME:-${HOME:-/root}/.local/share}:${XDG_DATA_DIRS:-/usr/local/share:/usr/share}"
    local roots root file
    IFS=: read -r -a roots <<<"$configuration:/usr/local/etc:/etc:$data"
    for root in "${roots[@]}"; do
        for file in "$root"/vulkan/icd.d/*.json; do
            if [[ -n "$root" && -f "$file" ]]; then
                printf '%s\n' "$file"
            fi
        done
    done
}

# A Vulkan driver of a real GPU needs both its file and the device; without the device, only a software driver renders.
# Prints what is there: "gpu", "software", or nothing.
vulkan_driver_kind() {
    local file kind=""
    while read -r file; do
        case "${file##*/}" in
            lvp_icd* | *swiftshader*) kind="${kind:-software}" ;;
            nvidia*) if [[ -e /dev/nvidiactl ]]; then kind=gpu; fi ;;
            dzn*) if [[ -e /dev/dxg ]]; then kind=gpu; fi ;;
            *) if compgen -G '/dev/dri/renderD*' >/dev/null; then kind=gpu; fi ;;
        esac
    done < <(vulkan_driver_files)
    printf '%s' "$kind"
}

needs_vulkan() {
    # On macOS and Windows the system brings Metal or DirectX 12.
    is_linux || return 0
    has_vulkan_loader || need "libvulkan1" "the Vulkan loader, through which Skycell finds a graphics driver"
    local named="${VK_DRIVER_FILES:-${VK_ICD_FILENAMES:-}}" files file
    if [[ -n "$named" ]]; then
        # Whoever names a driver hides all others and knows why; only a name that leads nowhere is an error.
        IFS=: read -r -a files <<<"$named"
        for file in "${files[@]}"; do
            if [[ -e "$file" ]]; then
                return 0
            fi
        done
        die "VK_DRIVER_FILES or VK_ICD_FILENAMES is $named, which is not there and hides every other driver; unset it or mend it"
    fi
    if [[ -z "$(vulkan_driver_kind)" ]]; then
        need "mesa-vulkan-drivers" "a Vulkan driver: none that could render was found, and Mesa brings one that needs no GPU"
    fi
}

# Prints the Chromium or Chrome that is there, if any.
find_chromium() {
    local name
    for name in chromium chromium-browser google-chrome-stable google-chrome; do
        command -v "$name" && return 0
    done
    return 1
}

is_ubuntu() {
    [[ -r /etc/os-release ]] && grep -q '^ID=ubuntu$' /etc/os-release
}

needs_chromium() {
    if [[ -n "${CHROMIUM:-}" ]] || find_chromium >/dev/null; then
        return 0
    fi
    if is_ubuntu; then
        say "NO BROWSER: the page's tests need one, and Ubuntu's apt-get has none. Get it with: snap install chromium"
        return 0
    fi
    need "chromium" "a browser, in which the tests open the page"
}

# The apt-get commands for the packages that are missing, to be read or run by a shell.
apt_commands() {
    printf '%sapt-get update && %sapt-get install -y --no-install-recommends %s' "$1" "$1" "${missing_packages[*]}"
}

# Says what is missing and why.
tell_missing() {
    local reason
    say "missing:"
    for reason in "${missing_reasons[@]}"; do
        printf '  %s\n' "$reason" >&2
    done
}

# Installs what needs_* functions have found missing. Without anything missing it needs neither root nor a network.
install_missing() {
    if ((${#missing_packages[@]} == 0)); then
        return 0
    fi
    tell_missing
    if ! command -v apt-get >/dev/null; then
        die "there is no apt-get here; install what corresponds to: ${missing_packages[*]}"
    fi
    local as_root=()
    if ((EUID != 0)); then
        if ! command -v sudo >/dev/null; then
            die "installing needs root, and there is no sudo. As root, run:
  $(apt_commands "")"
        fi
        as_root=(sudo)
        # Nobody is there to type a password.
        if [[ ! -t 0 ]] && ! sudo -n true 2>/dev/null; then
            die "installing needs root, and sudo asks for a password. Run:
  $(apt_commands "sudo ")"
        fi
    fi
    say "installing with apt-get${as_root:+ through sudo}: ${missing_packages[*]}"
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -q >&2 \
        || say "apt-get update failed; trying with the lists that are there"
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -q --no-install-recommends "${missing_packages[@]}" >&2 \
        || die "apt-get failed. The command was:
  $(apt_commands "${as_root:+sudo }")"
    hash -r
    missing_packages=()
    missing_reasons=()
}

# Graphics drivers and loaders warn, some refuse, without a runtime folder of the user's own.
set_runtime_dir() {
    if [[ -n "${XDG_RUNTIME_DIR:-}" ]]; then
        return 0
    fi
    local folder
    folder="${TMPDIR:-/tmp}/skycell-runtime-$(id -u)"
    # A folder of this name that somebody else made, or a link, is not to be trusted.
    if ! mkdir -m 700 "$folder" 2>/dev/null && { [[ -L "$folder" || ! -d "$folder" || ! -O "$folder" ]]; }; then
        folder="$(mktemp -d "${TMPDIR:-/tmp}/skycell-runtime-XXXXXX")"
    fi
    chmod 700 "$folder"
    export XDG_RUNTIME_DIR="$folder"
}

# Prints a Python 2.7, which the Autobahn test suite needs and distributions no longer have.
find_python2() {
    local python
    for python in "${PYTHON2:-}" python2.7 python2 "${PYENV_ROOT:-${HOME:-/root}/.pyenv}"/versions/2.7*/bin/python2.7; do
        if [[ -n "$python" ]] && "$python" -m pip --version >/dev/null 2>&1 \
            && "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (2, 7))'; then
            printf '%s' "$python"
            return 0
        fi
    done
    return 1
}

# The Autobahn test suite (WebSocket conformance), and the folder that it is installed into.
autobahn_version=25.10.1

# Installs the Autobahn test suite and sets SKYCELL_WSTEST; or says why not, and the tests say SKIPPED.
prepare_wstest() {
    [[ -z "${SKYCELL_WSTEST:-}" ]] || return 0
    local python folder
    if ! python="$(find_python2)"; then
        say "SKIPPED: the Autobahn test suite (WebSocket conformance), because there is no Python 2.7 with pip. To run it, set"
        say "PYTHON2 to one, or SKYCELL_WSTEST to its command wstest"
        return 0
    fi
    folder="$(target_folder)/autobahn-$autobahn_version"
    if [[ ! -x "$folder/wstest" ]]; then
        say "installing the Autobahn test suite $autobahn_version for $python into $folder, with pip"
        rm -rf "$folder"
        if ! "$python" -m pip install --quiet --disable-pip-version-check --no-warn-script-location \
            --target "$folder/site" "autobahntestsuite==$autobahn_version" >&2; then
            say "SKIPPED: the Autobahn test suite (WebSocket conformance), because pip could not install it"
            return 0
        fi
        # Its own command does not find packages of --target, some of which are reached by .pth files.
        {
            printf '#!/bin/sh\n'
            printf 'exec "%s" -c '\''import site; site.addsitedir("%s"); ' "$python" "$folder/site"
            printf 'from autobahntestsuite.wstest import run; run()'\'' "$@"\n'
        } >"$folder/wstest"
        chmod +x "$folder/wstest"
    fi
    export SKYCELL_WSTEST="$folder/wstest"
}

# Where cargo puts what it builds.
target_folder() {
    case "${CARGO_TARGET_DIR:-}" in
        "") printf '%s' "$repository/target" ;;
        /*) printf '%s' "$CARGO_TARGET_DIR" ;;
        *) printf '%s' "$repository/$CARGO_TARGET_DIR" ;;
    esac
}

# say_disk GB: says where less is free than building from nothing takes. Linkers on a full disk end with a bus error, which
# nobody would understand.
say_disk() {
    local wanted_gb="$1" folder free_kb used_kb
    folder="$(target_folder)"
    used_kb=0
    if [[ -d "$folder" ]]; then
        used_kb="$(du -sk "$folder" | cut -f 1)"
    else
        folder="$repository"
    fi
    free_kb="$(df -Pk "$folder" | awk 'NR == 2 { print $4 }')"
    if ((free_kb + used_kb < wanted_gb * 1000000)); then
        say "$((free_kb / 1000)) MB are free in $folder, where $((used_kb / 1000)) MB are built already: to build all takes about $wanted_gb GB"
    fi
}

# For --check: says what is missing and ends.
check_and_exit() {
    if ((${#missing_packages[@]} == 0)); then
        say "nothing is missing"
        exit 0
    fi
    tell_missing
    say "as root: $(apt_commands "")"
    exit 1
}
