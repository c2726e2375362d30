// SPDX-License-Identifier: Apache-2.0
#include "data/started_program.hpp"

#include <algorithm>
#include <array>
#include <mutex>
#include <thread>
#include <utility>

#include <windows.h>

#include <rye/core/error.hpp>

#include "data/system.hpp"
#include "data/windows_text.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

/// Handle that is closed with it.
struct Handle {
    HANDLE value = nullptr;
    Handle() = default;
    explicit Handle(HANDLE h) : value(h == INVALID_HANDLE_VALUE ? nullptr : h) {}
    ~Handle() { close(); }
    Handle(const Handle&) = delete;
    Handle& operator=(const Handle&) = delete;
    void close() {
        if (value != nullptr) ::CloseHandle(std::exchange(value, nullptr));
    }
};

struct Pipe {
    Handle reading, writing; // started programs get the writing end
    Pipe() {
        require(::CreatePipe(&reading.value, &writing.value, nullptr, 0) != 0, "pipe",
                "cannot be made: ", [] { return system_text(::GetLastError()); });
        ::SetHandleInformation(writing.value, HANDLE_FLAG_INHERIT, HANDLE_FLAG_INHERIT);
    }
};

/// Opens a file for a program that is started; throws an Error if it cannot be opened.
HANDLE opened(const fs::path& file, DWORD access, DWORD creation) {
    SECURITY_ATTRIBUTES inherited{sizeof inherited, nullptr, TRUE};
    const HANDLE handle =
        ::CreateFileW(file.c_str(), access, FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE,
                      &inherited, creation, FILE_ATTRIBUTE_NORMAL, nullptr);
    require(handle != INVALID_HANDLE_VALUE, file.string(),
            "cannot be opened: ", [] { return system_text(::GetLastError()); });
    return handle;
}

/// Appends a word to a command line, so that programs find it in their argv as it is: between
/// quotes, with a backslash before each quote and before those that precede a quote.
void append_word(std::wstring& line, const std::wstring& word) {
    if (!line.empty()) line += L' ';
    if (!word.empty() && word.find_first_of(L" \t\n\v\"") == std::wstring::npos) {
        line += word;
        return;
    }
    line += L'"';
    std::size_t slashes = 0;
    for (const wchar_t c : word) {
        if (c == L'"') line.append(slashes + 1, L'\\');
        slashes = c == L'\\' ? slashes + 1 : 0;
        line += c;
    }
    line.append(slashes, L'\\');
    line += L'"';
}

/// Returns the job of all programs that are started: the system ends them when this process ends,
/// which closes it.
HANDLE job() {
    static const HANDLE one = [] {
        const HANDLE made = ::CreateJobObjectW(nullptr, nullptr);
        JOBOBJECT_EXTENDED_LIMIT_INFORMATION limits{};
        limits.BasicLimitInformation.LimitFlags = JOB_OBJECT_LIMIT_KILL_ON_JOB_CLOSE;
        ::SetInformationJobObject(made, JobObjectExtendedLimitInformation, &limits, sizeof limits);
        return made;
    }();
    return one;
}

} // namespace

struct StartedProgram::Process {
    Handle handle;
    DWORD id = 0;
    std::optional<Pipe> out, err;

    void start(const fs::path& file, const std::vector<std::string>& words, HANDLE output,
               HANDLE errors, bool own_group) {
        std::wstring line;
        for (const std::string& word : words) append_word(line, wide_of(word));
        const Handle in(opened("NUL", GENERIC_READ, OPEN_EXISTING));
        STARTUPINFOW streams{};
        streams.cb = sizeof streams;
        streams.dwFlags = STARTF_USESTDHANDLES;
        streams.hStdInput = in.value;
        streams.hStdOutput = output;
        streams.hStdError = errors;
        PROCESS_INFORMATION made{};
        const DWORD how = CREATE_SUSPENDED | (own_group ? CREATE_NEW_PROCESS_GROUP : 0);
        require(::CreateProcessW(file.c_str(), line.data(), nullptr, nullptr, TRUE, how, nullptr,
                                 nullptr, &streams, &made) != 0,
                words.front(),
                "cannot be started: ", [] { return system_text(::GetLastError()); });
        ::AssignProcessToJobObject(job(), made.hProcess);
        ::ResumeThread(made.hThread);
        ::CloseHandle(made.hThread);
        handle.value = made.hProcess;
        id = made.dwProcessId;
    }
};

StartedProgram::StartedProgram(const fs::path& file, const std::vector<std::string>& words)
    : process_(std::make_unique<Process>()) {
    Process& p = *process_;
    p.start(file, words, p.out.emplace().writing.value, p.err.emplace().writing.value, false);
    p.out->writing.close();
    p.err->writing.close();
}

StartedProgram::StartedProgram(const fs::path& file, const std::vector<std::string>& words,
                               const OutputFiles& output)
    : process_(std::make_unique<Process>()) {
    const Handle out(opened(output.out, FILE_APPEND_DATA, OPEN_ALWAYS));
    const Handle err(opened(output.errors, GENERIC_WRITE, CREATE_ALWAYS));
    process_->start(file, words, out.value, err.value, true);
}

StartedProgram::~StartedProgram() = default;
StartedProgram::StartedProgram(StartedProgram&&) noexcept = default;
StartedProgram& StartedProgram::operator=(StartedProgram&&) noexcept = default;

void StartedProgram::read(const std::function<void(bool, std::string_view)>& take) {
    std::mutex one_at_once;
    const auto read_all = [&](bool errors) {
        const HANDLE pipe = (errors ? process_->err : process_->out)->reading.value;
        std::array<char, 4096> bytes{};
        for (DWORD n = 0; ::ReadFile(pipe, bytes.data(), bytes.size(), &n, nullptr) != 0;) {
            const std::lock_guard lock(one_at_once);
            take(errors, {bytes.data(), n});
        }
    };
    std::thread beside(read_all, true);
    try {
        read_all(false);
    } catch (...) {
        beside.join();
        throw;
    }
    beside.join();
}

int StartedProgram::wait() {
    ::WaitForSingleObject(process_->handle.value, INFINITE);
    DWORD code = 0;
    ::GetExitCodeProcess(process_->handle.value, &code);
    return static_cast<int>(code);
}

std::optional<int> StartedProgram::ended() {
    if (::WaitForSingleObject(process_->handle.value, 0) != WAIT_OBJECT_0) return std::nullopt;
    return wait();
}

void StartedProgram::stop() {
    // Without a console to send it by, the program is ended.
    if (::GenerateConsoleCtrlEvent(CTRL_BREAK_EVENT, process_->id) == 0)
        ::TerminateProcess(process_->handle.value, static_cast<UINT>(128 + SIGTERM));
}

fs::path own_program() { return program_file(); }

std::vector<fs::path> program_folders() {
    const std::string path = environment("PATH").value_or("");
    std::vector<fs::path> folders;
    for (std::size_t begin = 0; begin < path.size();) {
        const std::size_t end = std::min(path.find(';', begin), path.size());
        if (end > begin) folders.emplace_back(path.substr(begin, end - begin));
        begin = end + 1;
    }
    return folders;
}

std::optional<fs::path> program_in(const fs::path& folder, const std::string& name) {
    const fs::path file = folder / (name + ".exe");
    std::error_code ignored;
    if (fs::is_regular_file(file, ignored)) return file;
    return std::nullopt;
}

} // namespace rye::trainer
