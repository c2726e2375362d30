// SPDX-License-Identifier: Apache-2.0
// A libnccl.so.2 for ranks in threads whose devices' memory is the host's: each function does its
// work before it returns. A rank that waits returns an error if its communicator is aborted.
#include <array>
#include <condition_variable>
#include <cstddef>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace {

struct Id {
    char bytes[128];
};

constexpr int success = 0, system_error = 2, invalid_usage = 5;

struct Place {
    std::mutex mutex;
    std::condition_variable all_here;
    int size = 0, here = 0;
    std::size_t round = 0;
    std::vector<const void*> shown;
};

/// A send or a receive of a group of calls.
struct Part {
    const float* from;
    float* to;
    std::size_t count;
    int peer;
};

struct Comm {
    std::shared_ptr<Place> place;
    int rank = 0;
    bool aborted = false;
    std::vector<Part> sends, receives;

    /// Returns false if it was aborted while it waited.
    bool meet() {
        std::unique_lock<std::mutex> lock(place->mutex);
        const std::size_t now = place->round;
        if (++place->here == place->size) {
            place->here = 0;
            ++place->round;
            place->all_here.notify_all();
            return true;
        }
        place->all_here.wait(lock, [&] { return place->round != now || aborted; });
        return place->round != now;
    }
    template <class X, class F>
    int with_all(const X* own, const F& f) {
        place->shown[static_cast<std::size_t>(rank)] = own;
        if (!meet()) return system_error;
        for (int r = 0; r < place->size; ++r)
            f(r, static_cast<const X*>(place->shown[static_cast<std::size_t>(r)]));
        return meet() ? success : system_error;
    }
};

std::mutex places_mutex;
std::map<std::string, std::shared_ptr<Place>> places;
thread_local bool grouped = false;
thread_local Comm* of_group = nullptr;

Comm& of(void* comm) { return *static_cast<Comm*>(comm); }

} // namespace

extern "C" {

int rye_fake_nccl() { return 1; }

int ncclGetUniqueId(Id* id) {
    static int count = 0;
    const std::lock_guard<std::mutex> lock(places_mutex);
    std::memset(id, 0, sizeof *id);
    id->bytes[0] = static_cast<char>(++count);
    id->bytes[127] = 7; // the whole of it must arrive
    return success;
}
int ncclCommInitRank(void** comm, int size, Id id, int rank) {
    if (id.bytes[127] != 7) return invalid_usage;
    auto* const own = new Comm;
    {
        const std::lock_guard<std::mutex> lock(places_mutex);
        auto& place = places[std::string(id.bytes, sizeof id.bytes)];
        if (!place) {
            place = std::make_shared<Place>();
            place->size = size;
            place->shown.resize(static_cast<std::size_t>(size));
        }
        own->place = place;
        own->rank = rank;
    }
    *comm = own;
    return own->meet() ? success : system_error;
}
int ncclCommDestroy(void* comm) {
    delete &of(comm);
    return success;
}
int ncclCommAbort(void* comm) { // not freed: its owner may be in a call
    const std::lock_guard<std::mutex> lock(of(comm).place->mutex);
    of(comm).aborted = true;
    of(comm).place->all_here.notify_all();
    return success;
}
int ncclCommGetAsyncError(void*, int* error) {
    *error = success;
    return success;
}
const char* ncclGetErrorString(int code) {
    return code == system_error ? "unhandled system error" : "invalid usage";
}
int ncclGroupStart() {
    grouped = true;
    return success;
}
int ncclSend(const void* from, std::size_t count, int type, int peer, void* comm, void*) {
    if (!grouped || type != 7) return invalid_usage;
    of_group = &of(comm);
    of_group->sends.push_back({static_cast<const float*>(from), nullptr, count, peer});
    return success;
}
int ncclRecv(void* to, std::size_t count, int type, int peer, void* comm, void*) {
    if (!grouped || type != 7) return invalid_usage;
    of_group = &of(comm);
    of_group->receives.push_back({nullptr, static_cast<float*>(to), count, peer});
    return success;
}
int ncclGroupEnd() {
    grouped = false;
    Comm& own = *of_group;
    int unmatched = 0;
    const int got = own.with_all(&own.sends, [&](int r, const std::vector<Part>* theirs) {
        for (const Part& to : own.receives) {
            if (to.peer != r) continue;
            const Part* found = nullptr;
            for (const Part& from : *theirs)
                if (from.peer == own.rank) found = &from;
            if (found == nullptr || found->count != to.count)
                ++unmatched;
            else
                std::memmove(to.to, found->from, to.count * sizeof(float));
        }
    });
    own.sends.clear();
    own.receives.clear();
    return unmatched > 0 ? invalid_usage : got;
}
int ncclAllGather(const void* from, void* to, std::size_t count, int type, void* comm, void*) {
    if (type != 7) return invalid_usage;
    return of(comm).with_all(static_cast<const float*>(from), [&](int r, const float* theirs) {
        float* const part = static_cast<float*>(to) + static_cast<std::size_t>(r) * count;
        if (part != theirs) std::memmove(part, theirs, count * sizeof(float));
    });
}
int ncclAllReduce(const void* from, void* to, std::size_t count, int type, int op, void* comm,
                  void*) {
    if (type != 7 || op != 0) return invalid_usage;
    std::vector<float> sum(count, 0.0F);
    const int got =
        of(comm).with_all(static_cast<const float*>(from), [&](int, const float* theirs) {
            for (std::size_t i = 0; i < count; ++i) sum[i] += theirs[i];
        });
    std::memcpy(to, sum.data(), count * sizeof(float));
    return got;
}

} // extern "C"
