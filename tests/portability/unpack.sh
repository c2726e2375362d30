# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=sh
# unpack.sh: read with `.` by scripts that need Debian packages of another suite or processor.
#   unpack SUITE ARCHITECTURE FOLDER PACKAGE...   unpacks them into the folder, an absolute path;
#                                                 none is installed
# It fails where no Debian mirror can be read. FOLDER/versions lists what was unpacked.
unpack() {
    suite=$1 architecture=$2 folder=$3
    shift 3
    [ ! -e "$folder/unpacked" ] || return 0
    command -v apt-get > /dev/null && command -v dpkg > /dev/null || return 1
    site=$(apt-get indextargets --format '$(LABEL) $(REPO_URI)' 'Created-By: Packages' |
        sed -n 's/^Debian //p' | head -n 1)
    [ -n "$site" ] || return 1
    rm -rf "$folder"
    mkdir -p "$folder/apt/lists/partial" "$folder/apt/archives/partial"
    keys=/usr/share/keyrings/debian-archive-keyring.gpg
    if [ -e "$keys" ]; then keys=" signed-by=$keys"; else keys=; fi
    echo "deb [arch=$architecture$keys] $site $suite main" > "$folder/apt/sources.list"
    cat > "$folder/apt/apt.conf" << EOF
Dir::State "$folder/apt";
Dir::State::status "/dev/null";
Dir::Cache "$folder/apt";
Dir::Etc::SourceList "$folder/apt/sources.list";
Dir::Etc::SourceParts "/dev/null";
APT::Architecture "$architecture";
APT::Architectures { "$architecture"; };
APT::Sandbox::User "root";
Acquire::Languages "none";
EOF
    ( export APT_CONFIG="$folder/apt/apt.conf"
        cd "$folder/apt"
        apt-get -qq update && apt-get -qq download "$@" ) > "$folder/apt.log" 2>&1 || return 1
    for package in "$folder"/apt/*.deb; do
        dpkg -x "$package" "$folder" || return 1
        basename "$package" .deb | sed 's/_[^_]*$//; s/_/ /' >> "$folder/versions"
    done
    rm -rf "$folder/apt"
    touch "$folder/unpacked"
}
