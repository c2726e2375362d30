// SPDX-License-Identifier: Apache-2.0
#include "data/system.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <cwchar>
#include <limits>
#include <utility>

#include <fcntl.h>
#include <io.h>
#include <sys/stat.h>

#include <windows.h>

#include <shellapi.h>

#include <rye/core/error.hpp>

#include "data/windows_text.hpp"

/// By this libstdc++ makes paths of texts (the linker puts it in mbrtowc's place): from UTF-8, which
/// they are written as too, where the C library takes bytes for characters. Of a character of four
/// bytes the state keeps the second unit, whose turn is at the last byte.
extern "C" std::size_t __wrap_mbrtowc(wchar_t* to, const char* from, std::size_t size,
                                      std::mbstate_t* state);
std::size_t __wrap_mbrtowc(wchar_t* to, const char* from, std::size_t size,
                           std::mbstate_t* state) {
    if (size == 0) return static_cast<std::size_t>(-2);
    if (*state != 0) {
        *to = static_cast<wchar_t>(std::exchange(*state, 0));
        return 1;
    }
    const auto first = static_cast<unsigned char>(*from);
    const std::size_t bytes = first < 0x80 ? 1 : first < 0xE0 ? 2 : first < 0xF0 ? 3 : 4;
    if (bytes > size) return static_cast<std::size_t>(-1);
    wchar_t units[2];
    const int count = ::MultiByteToWideChar(CP_UTF8, MB_ERR_INVALID_CHARS, from,
                                            static_cast<int>(bytes), units, 2);
    if (count == 0) return static_cast<std::size_t>(-1);
    *to = units[0];
    if (count == 1) return units[0] == L'\0' ? 0 : bytes;
    *state = units[1];
    return bytes - 1;
}

namespace rye::trainer {

namespace fs = std::filesystem;

namespace {

HANDLE handle_of(Stream stream) {
    return ::GetStdHandle(stream == Stream::output ? STD_OUTPUT_HANDLE : STD_ERROR_HANDLE);
}

} // namespace

void begin_program(int& argc, char**& argv) {
    static std::vector<std::string> words;
    static std::vector<char*> pointers;
    int count = 0;
    if (wchar_t** const wide = ::CommandLineToArgvW(::GetCommandLineW(), &count)) {
        for (int i = 0; i < count; ++i) words.push_back(utf8_of(wide[i]));
        ::LocalFree(wide);
        for (std::string& word : words) pointers.push_back(word.data());
        pointers.push_back(nullptr);
        argc = count;
        argv = pointers.data();
    }
    for (const int stream : {0, 1, 2}) ::_setmode(stream, _O_BINARY);
    ::SetConsoleOutputCP(CP_UTF8);
    for (const Stream stream : {Stream::output, Stream::errors})
        if (DWORD mode = 0; ::GetConsoleMode(handle_of(stream), &mode) != 0)
            ::SetConsoleMode(handle_of(stream), mode | ENABLE_VIRTUAL_TERMINAL_PROCESSING);
}

std::optional<std::string> environment(const char* name) {
    const wchar_t* const value = ::_wgetenv(wide_of(name).c_str());
    if (value == nullptr || *value == L'\0') return std::nullopt;
    return utf8_of(value);
}

// Another process stops this one by Ctrl-Break, which has a number of its own here.
int code_of_stop(int signal) { return 128 + (signal == SIGBREAK ? SIGTERM : signal); }
void ignore_file_size_signal() {}

bool is_terminal(Stream stream) {
    DWORD mode = 0;
    return ::GetConsoleMode(handle_of(stream), &mode) != 0;
}

std::size_t terminal_width() {
    CONSOLE_SCREEN_BUFFER_INFO info{};
    if (::GetConsoleScreenBufferInfo(handle_of(Stream::output), &info) == 0) return 0;
    return static_cast<std::size_t>(std::max(0, info.srWindow.Right - info.srWindow.Left + 1));
}

void write_output(ByteSpan bytes) {
    while (!bytes.empty()) {
        constexpr std::size_t most = 1U << 20U;
        const int n = ::_write(1, bytes.data(), static_cast<unsigned>(std::min(bytes.size(), most)));
        require(n > 0, "standard output",
                "cannot be written: ", [&] { return std::strerror(errno); });
        bytes = bytes.subspan(static_cast<std::size_t>(n));
    }
}

double machine_memory() {
    MEMORYSTATUSEX status{};
    status.dwLength = sizeof status;
    return ::GlobalMemoryStatusEx(&status) != 0 ? static_cast<double>(status.ullTotalPhys)
                                                : std::numeric_limits<double>::infinity();
}

fs::path program_file() {
    std::wstring name(32768, L'\0');
    name.resize(::GetModuleFileNameW(nullptr, name.data(), static_cast<DWORD>(name.size())));
    return name;
}

std::string system_name() {
    std::array<wchar_t, 256> host{};
    DWORD size = host.size();
    if (::GetComputerNameExW(ComputerNameDnsHostname, host.data(), &size) == 0) host[0] = L'\0';
    return utf8_of(host.data());
}

std::string process_words() {
    std::array<char, 32> since{};
    const std::time_t now = std::time(nullptr);
    std::tm utc{};
    if (::gmtime_s(&utc, &now) == 0)
        std::strftime(since.data(), since.size(), "%Y-%m-%dT%H:%M:%SZ", &utc);
    return "process " + std::to_string(::GetCurrentProcessId()) + " on " + system_name() +
           " since " + since.data();
}

AppendedFile::AppendedFile(const fs::path& path)
    : file_(::_wopen(path.c_str(), _O_WRONLY | _O_APPEND | _O_BINARY | _O_NOINHERIT)) {
    require(file_ >= 0, path.string(), "cannot be written: ", [&] { return std::strerror(errno); });
}

AppendedFile::~AppendedFile() { ::_close(file_); }

std::optional<AppendedFile::Failure> AppendedFile::append(std::string_view text) {
    const __int64 before = ::_lseeki64(file_, 0, SEEK_END);
    std::size_t done = 0;
    while (done < text.size()) {
        const int n =
            ::_write(file_, text.data() + done, static_cast<unsigned>(text.size() - done));
        if (n <= 0) {
            const std::string reason = std::strerror(errno);
            return Failure{reason, done == 0 || ::_chsize_s(file_, before) == 0};
        }
        done += static_cast<std::size_t>(n);
    }
    return std::nullopt;
}

// The open file is the lock: no other process may open it to write.

LockFile::LockFile(fs::path path, bool children_too)
    : path_(std::move(path)),
      children_too_(children_too) {}

LockFile::~LockFile() {
    if (file_ >= 0) ::_close(file_);
}

LockFile::Taking LockFile::take() {
    SECURITY_ATTRIBUTES inherited{sizeof inherited, nullptr, children_too_ ? TRUE : FALSE};
    const HANDLE handle =
        ::CreateFileW(path_.c_str(), GENERIC_READ | GENERIC_WRITE, FILE_SHARE_READ, &inherited,
                      OPEN_ALWAYS, FILE_ATTRIBUTE_NORMAL, nullptr);
    if (handle == INVALID_HANDLE_VALUE) {
        const DWORD reason = ::GetLastError();
        if (reason == ERROR_SHARING_VIOLATION) return Taking::held_by_another;
        throw Error(path_.string() + ": cannot be written: " + system_text(reason));
    }
    file_ = ::_open_osfhandle(reinterpret_cast<std::intptr_t>(handle), _O_BINARY);
    return Taking::done;
}

LockFile::Taking LockFile::look(const fs::path& path) {
    const HANDLE handle =
        ::CreateFileW(path.c_str(), GENERIC_READ | GENERIC_WRITE, FILE_SHARE_READ | FILE_SHARE_WRITE,
                      nullptr, OPEN_EXISTING, FILE_ATTRIBUTE_NORMAL, nullptr);
    if (handle == INVALID_HANDLE_VALUE)
        return ::GetLastError() == ERROR_SHARING_VIOLATION ? Taking::held_by_another : Taking::done;
    ::CloseHandle(handle);
    return Taking::done;
}

std::string LockFile::words() const {
    const HANDLE handle =
        ::CreateFileW(path_.c_str(), GENERIC_READ, FILE_SHARE_READ | FILE_SHARE_WRITE, nullptr,
                      OPEN_EXISTING, FILE_ATTRIBUTE_NORMAL, nullptr);
    if (handle == INVALID_HANDLE_VALUE) return "";
    std::string text(400, '\0');
    DWORD n = 0;
    if (::ReadFile(handle, text.data(), static_cast<DWORD>(text.size()), &n, nullptr) == 0) n = 0;
    ::CloseHandle(handle);
    text.resize(n);
    return text;
}

void LockFile::write(const std::string& words) {
    if (::_chsize_s(file_, 0) == 0 && ::_lseeki64(file_, 0, SEEK_SET) == 0)
        ::_write(file_, words.data(), static_cast<unsigned>(words.size()));
}

} // namespace rye::trainer
