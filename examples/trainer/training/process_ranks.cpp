// SPDX-License-Identifier: Apache-2.0
#include "training/process_ranks.hpp"

#include <algorithm>
#include <charconv>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <iostream>
#include <iterator>
#include <map>
#include <mutex>
#include <optional>
#include <random>
#include <thread>

#include <rye/io/atomic_file.hpp>
#include <rye/io/bytes.hpp>

#include "data/system.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds look(50);
constexpr std::size_t most_bytes = 1 << 16;

double seconds_since(Clock::time_point t) {
    return std::chrono::duration<double>(Clock::now() - t).count();
}

/// Variables of a launcher; MPI's libraries have different ones.
struct Variables {
    const char *launcher, *rank, *size, *local;
};
constexpr Variables known[] = {
    {"torchrun", "RANK", "WORLD_SIZE", "LOCAL_RANK"},
    {"slurm", "SLURM_PROCID", "SLURM_NTASKS", "SLURM_LOCALID"},
    {"mpi", "OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_LOCAL_RANK"},
    {"mpi", "PMI_RANK", "PMI_SIZE", "MPI_LOCALRANKID"}};

int number_in(const char* name, const std::string& text) {
    int value = 0;
    const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), value);
    require(fault == std::errc() && end == text.data() + text.size() && value >= 0, name, "got '",
            text, "', expected a whole number, 0 or more");
    return value;
}

std::string random_word() {
    std::random_device source;
    std::string word;
    for (int i = 0; i < 16; ++i) word += "0123456789abcdef"[source() % 16];
    return word;
}

/// Returns what a file holds; nothing while it is not there.
std::optional<std::string> contents(const fs::path& path) {
    std::error_code fault;
    if (!fs::exists(path, fault)) return std::nullopt;
    try {
        const Bytes bytes = read_file(path, most_bytes);
        return std::string(as_text(bytes));
    } catch (const Error&) {
        return std::nullopt; // it is being replaced
    }
}

void put(const fs::path& path, const std::string& text) {
    write_atomic(path, as_bytes(text), Durability::atomic_only);
}

} // namespace

bool is_launcher(const std::string& name) {
    return std::any_of(std::begin(known), std::end(known),
                       [&](const Variables& v) { return name == v.launcher; });
}

int parsed_ranks(const std::string& text, const std::string& who) {
    int value = 0;
    const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), value);
    require(fault == std::errc() && end == text.data() + text.size() && value >= 1 && value <= 1024,
            who, "got '", text, "', expected a number from 1 to 1024, torchrun, mpi or slurm");
    return value;
}

LaunchedRank launched_by(const std::string& launcher) {
    const Variables* first = nullptr;
    for (const Variables& v : known) {
        if (launcher != v.launcher) continue;
        if (first == nullptr) first = &v;
        const auto rank = environment(v.rank), size = environment(v.size);
        if (!rank || !size) continue;
        LaunchedRank r{number_in(v.rank, *rank), number_in(v.size, *size), 0};
        require(r.rank < r.size, v.rank, "got ", r.rank, ", expected less than ", v.size, ", ",
                r.size);
        if (const auto local = environment(v.local)) r.local = number_in(v.local, *local);
        return r;
    }
    require(first != nullptr, "--ranks", "got '", launcher, "', which is no launcher");
    throw Error("--ranks: got " + launcher + ", but the variables " + first->rank + " and " +
                first->size + " are not in the environment, expected a process that " + launcher +
                " started");
}

/// Files of a meeting, and the thread of this rank's signs of life.
struct RanksInProcesses::Meeting {
    fs::path folder;
    LaunchedRank place;
    RankTimes times;
    std::string name; ///< of this start, drawn by rank 0
    int words = 0;    ///< number of given() so far
    std::mutex mutex;
    std::condition_variable wake;
    bool over = false;
    std::thread signs;
    struct Heard {
        std::string sign;
        Clock::time_point since;
    };
    std::map<int, Heard> heard;
    std::string reason; ///< why another rank has ended, once that is known

    fs::path file(const std::string& what, int rank) const {
        return folder / (what + "_" + std::to_string(rank));
    }
    fs::path named(const std::string& what, int number) const {
        return folder / (name + "_" + what + "_" + std::to_string(number));
    }

    /// Finds the start's name: each rank shows a number of its own, rank 0 its name with all of
    /// them, and each rank that it has seen that name.
    void arrive() {
        const Clock::time_point begin = Clock::now();
        const std::string own = random_word();
        bool told = false;
        put(file("came", place.rank), own);
        if (place.rank == 0) name = own;
        for (;; std::this_thread::sleep_for(look)) {
            std::string missing;
            if (place.rank == 0) {
                std::string all = name;
                for (int r = 1; r < place.size; ++r) {
                    const auto theirs = contents(file("came", r));
                    if (theirs) all += " " + std::to_string(r) + ":" + *theirs;
                    if (contents(file("seen", r)) != name)
                        missing += (missing.empty() ? "" : ", ") + std::to_string(r);
                }
                if (missing.empty()) return;
                if (contents(folder / "start") != all) put(folder / "start", all);
            } else {
                missing = "0";
                const std::string mine = " " + std::to_string(place.rank) + ":" + own;
                if (const auto all = contents(folder / "start");
                    all && all->find(mine) != std::string::npos) {
                    name = all->substr(0, all->find(' '));
                    put(file("seen", place.rank), name);
                    return;
                }
            }
            const double waited = seconds_since(begin);
            require(waited < times.arrival, folder.string(), "rank ", missing, " of ", place.size,
                    " has not come for ", static_cast<int>(waited), " s");
            if (waited > 10 && !told) {
                told = true;
                std::cerr << "rye train: rank " << place.rank << " waits for rank " << missing
                          << "\n";
            }
        }
    }

    void give_signs() {
        std::unique_lock<std::mutex> lock(mutex);
        for (int count = 0; !over; ++count) {
            lock.unlock();
            try {
                put(named("alive", place.rank), std::to_string(count));
            } catch (const Error&) {
                // The others find that there is none.
            }
            lock.lock();
            wake.wait_for(lock, std::chrono::duration<double>(times.sign), [&] { return over; });
        }
    }

    std::string reason_now() {
        const std::lock_guard<std::mutex> lock(mutex);
        if (!reason.empty()) return reason;
        for (int r = 0; r < place.size; ++r) {
            if (r == place.rank) continue;
            if (const auto why = contents(named("ended", r)))
                return reason = "rank " + std::to_string(r) + " ended: " + *why;
            if (contents(named("done", r))) continue;
            const std::string sign = contents(named("alive", r)).value_or("");
            const auto [known, fresh] = heard.try_emplace(r, Heard{sign, Clock::now()});
            if (known->second.sign != sign) known->second = {sign, Clock::now()};
            if (const double silent = seconds_since(known->second.since); silent > times.patience)
                return reason = "rank " + std::to_string(r) + " ended: no sign of life for " +
                                std::to_string(static_cast<int>(silent)) + " s";
        }
        return "";
    }
    void end_signs() {
        if (!signs.joinable()) return;
        {
            const std::lock_guard<std::mutex> lock(mutex);
            over = true;
        }
        wake.notify_all();
        signs.join();
    }
};

RanksInProcesses::RanksInProcesses(const fs::path& run, const LaunchedRank& place,
                                   const RankTimes& times)
    : meeting_(std::make_unique<Meeting>()) {
    Meeting& m = *meeting_;
    m.folder = run / "ranks";
    m.place = place;
    m.times = times;
    std::error_code fault;
    fs::create_directories(m.folder, fault);
    require(fs::is_directory(m.folder), m.folder.string(),
            "cannot be made: ", [&] { return fault.message(); });
    m.arrive();
    m.signs = std::thread([&m] { m.give_signs(); });
}

RanksInProcesses::~RanksInProcesses() {
    Meeting& m = *meeting_;
    m.end_signs();
    std::error_code ignored;
    try {
        put(m.named("done", m.place.rank), "");
        if (m.place.rank != 0) return;
        // Rank 0 leaves nothing behind, once the others need nothing any more.
        const Clock::time_point begin = Clock::now();
        const auto all_done = [&] {
            for (int r = 1; r < m.place.size; ++r)
                if (!contents(m.named("done", r))) return false;
            return true;
        };
        while (!all_done()) {
            // Those that still run may want to read why.
            if (!m.reason_now().empty() || seconds_since(begin) > m.times.patience) return;
            std::this_thread::sleep_for(look);
        }
    } catch (const Error&) {
        return; // files for other ranks only
    }
    fs::remove_all(m.folder, ignored);
}

int RanksInProcesses::rank() const { return meeting_->place.rank; }
int RanksInProcesses::size() const { return meeting_->place.size; }

std::string RanksInProcesses::given(const std::string& own) {
    Meeting& m = *meeting_;
    const fs::path file = m.named("given", m.words++);
    if (m.place.rank == 0) {
        put(file, own);
        return own;
    }
    for (;; std::this_thread::sleep_for(look)) {
        const bool done = contents(m.named("done", 0)).has_value(); // before its last words
        if (auto words = contents(file)) return *words;
        // One that has ended by an error is done, too, and said why before.
        const std::string reason = m.reason_now();
        if (!reason.empty()) throw Error(reason);
        require(!done, m.folder.string(), "rank 0 is done, while rank ", m.place.rank,
                " waits for it");
    }
}

std::string RanksInProcesses::ended() { return meeting_->reason_now(); }

void RanksInProcesses::leave(const std::string& reason) noexcept {
    try {
        put(meeting_->named("ended", meeting_->place.rank), reason);
    } catch (const std::exception&) {
        // The others find that there are no signs of life.
    }
}

} // namespace rye::trainer
